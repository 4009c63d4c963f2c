"""Rigs: plate, cells, driver, camera and parameters, read from rig files and checked.

A rig file becomes a `Rig` in three steps (`_build`): keys and types by pydantic (`_schema`), then
units, names and geometry, part by part, then values in SI units. A quantity of the file is a
`Value` (`_value`): a number, or a number times parameters to powers, so that a match can change it.
Which file holds what:

- reading: `_build`, `_fields` (texts to values), `_units`, `_toml` (files and messages), and
  `_variants` (the same rig on another grid, or with cells at other places)
- the plate: `_plate`
- what stands on it: `_cell`, `_heater`, and where they lie (`_placement`); `_bodies`, with links
  and circuits
- what drives and reads it: `_instruments`; a kind of sensor (`_sensors`) says what a channel
  reads, weighs and shows, by the means of `_zone_means`
- parameters and other inputs: `_value`, `_parameter_table`, `_parameter_file`
- the whole: `_rig`
- writing: `_new_rig` (a first rig file)
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
