"""A memory of twins: every version that was matched, and which of them is in use.

`TwinStore` (`_store`) is one SQLite file (`_schema`). A version is a saved fit with the noise of
its observer, its parent and the reason why it was made; it never changes. Aliases move from version
to version, with the words of MLflow: `champion` is the twin in use, `challenger` one that waits,
and `previous` what the champion was before. `_version` is what is known of a version, and of the
difference of two. An address such as `twins.db@champion` stands for the file of a fit everywhere:
`jaxtwin._twin_address`, beside the packages, reads it.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
