"""Crack lines for tests."""

from __future__ import annotations

import numpy as np

from tilepipe_kernels.polylines.crack_lines import trace_crack_lines
from tilepipe_kernels.polylines.join import CrackLines, join_crack_lines


def crack_lines_of(labels: np.ndarray) -> CrackLines:
    """Lines along all borders of a label image."""
    h, v = np.zeros((2, *labels.shape), np.uint8)
    h[:-1], v[:, :-1] = labels[1:] != labels[:-1], labels[:, 1:] != labels[:, :-1]
    return join_crack_lines([trace_crack_lines(h, v, labels.astype(np.float32))])
