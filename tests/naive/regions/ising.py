"""Exact marginal probabilities of a binary field by going through all its states."""

from __future__ import annotations

from itertools import product

import numpy as np


def marginals(edges: np.ndarray, coupling: np.ndarray, evidence: np.ndarray) -> np.ndarray:
    """Probability of class 1 at each node: a state weighs exp(evidence of its ones + coupling of its equal pairs)."""
    total, one = 0.0, np.zeros(len(evidence))
    for state in product((0, 1), repeat=len(evidence)):
        s = np.array(state)
        weight = np.exp(evidence @ s + coupling @ (s[edges[:, 0]] == s[edges[:, 1]]))
        total += weight
        one += weight * s
    return one / total
