"""The conformance test of a device: what its firmware does with each command and each fault.

`_conform` is the entry, and talks to the device by `_dialogue`; `_commands`, `_watchdog` and
`_trips` are the parts of the script.
"""
