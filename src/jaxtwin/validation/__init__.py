"""Validation: how well a matched twin predicts recordings that the match has not seen.

`_validate` predicts another recording, the rest of one, or a group that was left out, and returns a
`Validation` (`_validation`), which tests whether what is left is only noise.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
