"""What is done along the symmetry that is stored on a mesh."""
