"""Mutation testing: whether the tests see small changes of the code."""
