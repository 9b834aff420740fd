"""What is possible on a frame: a decoder that knows the scene, as a reference for receivers."""
