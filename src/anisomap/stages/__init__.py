"""The stages of a method on sensors: similarity, scaling of each component, refinement."""
