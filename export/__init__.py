"""From a checkpoint to the one ONNX graph that flies."""
