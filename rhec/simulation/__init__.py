"""Scenarios, the closed loop that runs them, their metrics, and campaigns of many."""
