/* Stands for the C library's, which a page does not have: what is not our own (elementary.h) is the
   browser's Math. A square root is an instruction. */
#pragma once
#define OF_MATH(name) __attribute__((import_module("Math"), import_name(#name))) double name
OF_MATH(log)(double);
OF_MATH(pow)(double, double);
OF_MATH(sin)(double);
OF_MATH(cos)(double);
OF_MATH(tan)(double);
OF_MATH(asin)(double);
OF_MATH(acos)(double);
OF_MATH(atan)(double);
OF_MATH(atan2)(double, double);
OF_MATH(sinh)(double);
OF_MATH(cosh)(double);
OF_MATH(tanh)(double);
#define sqrt __builtin_sqrt
#define ceil __builtin_ceil
#define INFINITY __builtin_inf()
#define NAN __builtin_nan("")
