"""Network definitions (PyTorch) and the released weights with their model cards."""
