"""The conformance test of a device: what its firmware does with each command and each fault.

`_conform` is the script, which talks to the device by `_dialogue`.
"""
