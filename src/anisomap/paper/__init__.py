"""The experiments of McGregor et al. (2011), every figure, table and claim, made again.

`reproduce` runs them all and leaves a folder with pictures, tables and one page. To add an
experiment, write a function and add a line to `EXPERIMENTS` (`anisomap.paper.registry`).

McGregor, Polani & Dautenhahn (2011), "Generation of Tactile Maps for Artificial Skin", PLoS ONE
6(11): e26561, doi:10.1371/journal.pone.0026561.
"""

from anisomap.paper.experiment import Document, Experiment, Outcome, Picture, Settings, Table
from anisomap.paper.registry import EXPERIMENTS
from anisomap.paper.runner import Done, reproduce

__all__ = [
    "EXPERIMENTS",
    "Document",
    "Done",
    "Experiment",
    "Outcome",
    "Picture",
    "Settings",
    "Table",
    "reproduce",
]
