"""Several runs at a time on one core, one in each SIMD lane of the processor's registers.

SIMD means single instruction, multiple data: a register holds two (SSE2), four (AVX) or eight
(AVX-512) numbers, its lanes, and one instruction computes with all of them. With eight lanes a core
simulates about 200 runs of 240 s per second, without lanes 50 (benchmark/README.md). The
results are the same to the last bit.

Lanes need a C and a C++ compiler, and some seconds to compile each loop once. `rhec.campaign` uses
them, and so does `rhec.simulate` of a list if that pays. `CXX=false` in the environment disables
them. Nothing else depends on them.
"""
