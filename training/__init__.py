"""Training of the learned features: plain PyTorch, one linear script."""
