"""Files of any kind: safe opening and writing, meshes, and readers in a process of their own."""
