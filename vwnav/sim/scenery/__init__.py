"""The generator: from a seed to vectors, and from vectors to images at any resolution."""
