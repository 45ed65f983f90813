"""Reproduction of the experiments, figures, tables and claims of McGregor et al. (2011).

`reproduce` runs the experiments and writes figures, tables and a page to a folder. To add an
experiment, decorate a function with `experiment`, and add its name to the order of the page
(`anisomap.paper.runner`).

References
----------
McGregor, Polani & Dautenhahn (2011), "Generation of Tactile Maps for Artificial Skin", PLoS ONE
6(11): e26561, doi:10.1371/journal.pone.0026561.
"""

from anisomap.paper.experiment import Document, Experiment, Picture, Settings, Table
from anisomap.paper.runner import EXPERIMENTS, Status, reproduce

__all__ = [
    "EXPERIMENTS",
    "Document",
    "Experiment",
    "Picture",
    "Settings",
    "Status",
    "Table",
    "reproduce",
]
