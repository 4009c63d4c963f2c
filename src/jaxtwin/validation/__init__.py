"""Validation: how well a matched twin predicts recordings that the match has not seen.

`_validate` predicts another recording, the rest of one, or a group that was left out, and returns a
`Validation` (`_validation`), which tests whether what is left is only noise.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
