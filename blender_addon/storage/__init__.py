"""Results that are stored on meshes: a match, its candidates, the report of a transfer, symmetries."""
