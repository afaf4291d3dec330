"""Many runs at a time on one core, one in each SIMD lane of the processor's registers.

SIMD (single instruction, multiple data): a register of today's processors holds two (SSE2), four
(AVX) or eight (AVX-512) numbers, its lanes, and one instruction computes with all of them. So one
core drives eight fields at once. With eight lanes a core makes about 200 runs of 240 s a second,
one by one 50 (tests/benchmark/README.md). The results are the same to the last bit.

Lanes need a C and a C++ compiler and some seconds to compile a loop, once. `rhec.campaign` and
`rhec.simulate` of a list use them where that pays. `CXX=false` in the environment switches them
off. Nothing else depends on them.
"""
