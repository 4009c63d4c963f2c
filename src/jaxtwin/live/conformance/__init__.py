"""The conformance test of a device: what its firmware does with each command and each fault.

`_conform` is the entry, and talks to the device by `_dialogue`; `_commands` is the part of the
script that is not about trips.
"""
