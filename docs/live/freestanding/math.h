/* Stands for the C library's, which a page does not have: what is not our own (elementary.h) is the
   browser's Math. A square root is an instruction. */
#define OF_MATH(name) __attribute__((import_module("Math"), import_name(#name))) double name
OF_MATH(log)(double);
OF_MATH(sin)(double); /* of more than a million radians */
OF_MATH(cos)(double);
OF_MATH(atan2)(double, double); /* of zero and infinity */
#define sqrt __builtin_sqrt
#define INFINITY __builtin_inf()
#define NAN __builtin_nan("")
