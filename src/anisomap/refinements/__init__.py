"""Steps that refine a map, and the loop that combines them: `anisomap.refinements.chain`."""
