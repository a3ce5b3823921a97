"""Images: histograms, filters, diffusion, morphology, distances."""
