"""Markov random fields of `edges`: the energy of labels and line elements, and what minimises it."""
