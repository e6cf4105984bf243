"""Sets of meshes with known correspondences, made rather than collected: `python -m benchmarks.generate NAME`."""
