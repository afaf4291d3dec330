/* What a processor does before main of a program that reads and writes by semihosting. */
#include <stdint.h>

extern uint32_t __StackTop;
extern void _start(void);

__attribute__((naked)) void reset(void)
{
    __asm("ldr r0, =0xE000ED88\n" /* the floating-point unit is off after a reset */
          "ldr r1, [r0]\n"
          "orr r1, r1, #(0xF << 20)\n"
          "str r1, [r0]\n"
          "dsb\n"
          "isb\n"
          "b _start\n");
}

static void fault(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void *const vectors[] = {&__StackTop, reset,
                                                                           fault,       fault};
