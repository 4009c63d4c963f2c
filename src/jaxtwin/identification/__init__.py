"""A twin from a log alone: the structure of its thermal network, and its values.

`_identify` averages the recordings to a uniform grid (`_log`), fits the simple models beside which
the twin is shown (`_baselines`), and matches all structures (`_structures`) of a family of networks
(`_network`) side by side (`_screening`). Held-out blocks judge the most probable ones; the best is
written as a rig file and matched to all readings. `_identified` is the result.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
