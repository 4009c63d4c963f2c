"""SPICE: a twin in an experiment as a netlist that another simulator runs."""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
