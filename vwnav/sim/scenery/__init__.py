"""The generator: from a seed to vectors, and from vectors to pictures at any resolution."""
