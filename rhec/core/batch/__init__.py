"""Many runs of one estimator or controller of any Model at a time, in SIMD lanes."""
