"""Files of any kind: safe opening and writing, meshes, and readers in a separate process."""
