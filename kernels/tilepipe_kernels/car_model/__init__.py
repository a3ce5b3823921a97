"""Conditional autoregressive (CAR) model of heights on a graph of regions: Gibbs draws, exact draws, diagnostics."""
