"""The recordings that the paper's authors published, with their checksums."""

from dataclasses import dataclass
from typing import final

# Each address names a commit, so that the files agree with the checksums.
_TWO_CELL_URL = (
    "https://raw.githubusercontent.com/tartanus/digital-twin-MIMO-peltier/"
    "e9e1f150f0ee3d278e11738eb07f0759c6317ef4/"
)
_SINGLE_CELL_URL = (
    "https://raw.githubusercontent.com/tartanus/DigitalTwinSLDOPeltier/"
    "46ac76e1bdcaa8f19c69c8eb92fafad818a8dfda/"
)


@final
@dataclass(frozen=True)
class PublishedRecording:
    """A file that the authors published.

    **Arguments:**

    - `name`: the path in a folder of recordings, with forward slashes.
    - `url`: the address from which it is fetched.
    - `sha256`: the SHA-256 of its bytes, as hexadecimal digits.
    """

    name: str
    url: str
    sha256: str


def _two_cell(file: str, sha256: str) -> PublishedRecording:
    return PublishedRecording(file, _TWO_CELL_URL + file, sha256)


def _single_cell(file: str, sha256: str) -> PublishedRecording:
    return PublishedRecording(f"single-cell/{file}", _SINGLE_CELL_URL + file, sha256)


TWO_CELL = (
    _two_cell(
        "peltierMIMOStepSecA.mat",
        "3759d961ec6d3d400c615cef9d5f6a13df0c81f36725f8db239b97abebfdd0d1",
    ),
    _two_cell(
        "peltierMIMOStepSecB.mat",
        "af223252cfb0d37f7d9f5e6d31d55fd16605468716829d30d6967df404a2592b",
    ),
    _two_cell(
        "peltierMIMOStepSecC.mat",
        "466301644f94b1ef19ecf76682040d91343544b3e9ac810727f2b0abb6c6740a",
    ),
)
"""The paper's rig: zones A, B and C, duty 128/255 and from 500 s on 200/255."""

SINGLE_CELL = (
    _single_cell(
        "BMData1_022722.mat", "cf3db06b9651b3ec4b8022430bc85d7df71c6092fc6cc072bc21f536858eb857"
    ),
    _single_cell(
        "BMData2_022722.mat", "cea65e10d094bfd5a5fe7f718d77d9992bd0243747187f58a02c9e1bf78bc0ce"
    ),
    _single_cell(
        "BMData3_022722.mat", "c36d910cd2d53c9131c499ea1c07538ba4f12bd2ddfcca47ad8f2c1ab74745e5"
    ),
    _single_cell(
        "BMData4_022722.mat", "0f4667338cea88dd8a8ff37bcac8566e44d14c311074c2807802af600bbe5f46"
    ),
)
"""The authors' rig with one cell: an hour each in closed loop, duty -1 to 1."""
