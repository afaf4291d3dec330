"""Many runs side by side on one core, one per SIMD lane."""
