"""Labels of least energy: Highest Confidence First, messages, descent, annealing."""
