"""SPICE: a twin in an experiment as a netlist that another simulator runs."""

from ._to_spice import to_spice

__all__ = ["to_spice"]
