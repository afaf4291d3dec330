/* Stands for the C library's, which a page does not have: these are instructions. */
#define memcpy __builtin_memcpy
#define memset __builtin_memset
