"""Fuzzing of all that reads files: `scripts/fuzz` runs it with coverage, `test_harnesses.py` for a moment without."""
