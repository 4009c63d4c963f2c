"""Controllers: what one is (`_controller`), its limits (`_duty_limits`), one kind a
file, their files and their laws in C.

To add one, write a class in a file of its own and enter it in `_controller_file`; a user's own
class needs `register_controller` only.
"""
