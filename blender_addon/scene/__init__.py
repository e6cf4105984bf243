"""Objects of the scene: which are meant, reading them, recognising edits, and what was cached of their meshes."""
