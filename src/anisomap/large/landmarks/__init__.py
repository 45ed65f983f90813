"""Maps of more sensors than pairs can be kept of: one file a step, in the order of the steps.

Frames are gone through twice. The first time, the readings of each sensor are projected onto a few
hundred numbers (`sketch`), from which those sensors are found that may be most like it
(`candidates`). The second time, Pearson r of these pairs is worked out exactly (`correlations`).
The best of them are the edges of a graph (`joining`); from about a thousand landmarks the shortest
paths to all sensors are found (`paths`); the landmarks are scaled, the others triangulated
(`triangulation`), and all are refined together (`refinement`).
"""
