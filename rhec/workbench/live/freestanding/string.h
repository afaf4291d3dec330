/* Stands for the C library's, which a page does not have: these are instructions. */
#pragma once
#define memcpy __builtin_memcpy
#define memset __builtin_memset
