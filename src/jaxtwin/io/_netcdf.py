"""Recordings as netCDF, in the form that `Experiment.to_xarray` gives them."""

import io
import warnings
from typing import IO, TYPE_CHECKING

import numpy as np

from .._celsius import ZERO_CELSIUS
from ..errors import RecordingError
from ._column_meaning import INPUT
from ._experiment import Experiment

if TYPE_CHECKING:
    import xarray

SECOND = ("s", "second", "seconds")
DUTY = ("1", "")
CELSIUS = ("degC", "°C", "celsius", "Celsius", "degree_Celsius", "degrees_Celsius", "degree_C")
KELVIN = ("K", "kelvin", "Kelvin")


def parse_netcdf(content: bytes, *, name: str) -> Experiment:
    """Reads the experiment in a netCDF file. Variables with other names are ignored."""
    return experiment_of_dataset(_dataset(content), name=name)


def experiment_of_dataset(data: "xarray.Dataset", *, name: str | None) -> Experiment:
    """The experiment in a data set; for the arguments see `Experiment.from_xarray`."""
    import xarray

    if not isinstance(data, xarray.Dataset):
        raise RecordingError(
            f"from_xarray: dataset: expected an xarray.Dataset, got {type(data).__name__}"
        )
    name = str(data.attrs.get("name", "")) if name is None else name
    time = _variable(data, "time", ("time",), SECOND)
    duty = _variable(data, "duty", ("time", "cell"), DUTY)
    cells: list[str] = []
    if "cell" in data.coords:
        cells = [str(cell) for cell in np.atleast_1d(data["cell"].values)]
    temperatures = ambient = None
    if "temperature" in data:
        temperatures = _variable(data, "temperature", ("time", "channel"), CELSIUS + KELVIN)
    if "ambient" in data:
        ambient = _variable(data, "ambient", ("time",), CELSIUS + KELVIN)
    channels: tuple[str, ...] = ()
    if "channel" in data.coords:
        channels = tuple(str(channel) for channel in np.atleast_1d(data["channel"].values))
    inputs = {
        name[1]: np.broadcast_to(data[name[0]].values.astype(_kind_of(data[name[0]])), time.shape)
        for name in (INPUT.fullmatch(str(variable)) for variable in data.data_vars)
        if name is not None
    }
    return Experiment(
        time,
        duty,
        cells=cells,
        channels=channels,
        temperatures=temperatures,
        ambient=ambient,
        inputs=inputs,
        name=name,
    )


def _kind_of(variable: "xarray.DataArray") -> type:
    """Text for names of states, which netCDF may give back as objects; otherwise numbers."""
    return float if variable.dtype.kind in "iufb" else str


def write_netcdf(dataset: "xarray.Dataset", stream: IO[bytes]) -> None:
    """Writes labelled data to a file that is open, as netCDF 3.

    netCDF 3 is used instead of netCDF 4, because it needs no extra library, and because a damaged
    file cannot stop its reader: a zeroed block in a netCDF 4 file can keep the HDF5 library (2.0)
    in an endless loop.
    """
    # By the name of the file: as bytes, the whole content would be in memory once more.
    dataset.to_netcdf(stream.name, engine="scipy")


def _dataset(content: bytes) -> "xarray.Dataset":
    import xarray

    engine = "scipy" if content.startswith(b"CDF") else "h5netcdf"
    if engine == "h5netcdf":
        _check_netcdf4(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about variables that are not read
            # times stay the numbers they are, instead of becoming time spans in ns
            opened = xarray.open_dataset(
                io.BytesIO(content), engine=engine, decode_times=False, decode_timedelta=False
            )
            with opened:
                wanted = ("time", "duty", "temperature", "ambient", "cell", "channel")
                inputs = [name for name in opened.data_vars if INPUT.fullmatch(str(name))]
                return opened[[name for name in (*wanted, *inputs) if name in opened]].load()
    except Exception as error:  # the libraries raise whatever the damaged bytes lead to
        raise RecordingError(f"is a damaged netCDF file ({type(error).__name__})") from None


def _check_netcdf4(content: bytes) -> None:
    """Checks that the file can be opened, because h5netcdf leaves a broken object behind if it
    cannot."""
    try:
        import h5netcdf  # noqa: F401
        import h5py
    except ImportError:
        raise RecordingError(
            "is a netCDF 4 file; reading it needs pip install 'jaxtwin[storage]', in a checkout "
            "pip install -e '.[storage]'"
        ) from None
    try:
        with h5py.File(io.BytesIO(content)) as file:
            file.attrs.get("_nc3_strict")
    except Exception as error:
        raise RecordingError(f"is a damaged netCDF file ({type(error).__name__})") from None


def _variable(
    data: "xarray.Dataset", name: str, dims: tuple[str, ...], units: tuple[str, ...]
) -> np.ndarray:
    """A variable with these dimensions in this order, in s, 1 or degC."""
    if name not in data:
        raise RecordingError(f"expected the variables 'time' and 'duty', got no {name!r}")
    variable = data[name]
    unknown = set(variable.dims) - set(dims)
    if unknown:
        raise RecordingError(
            f"variable {name!r}: expected the dimensions {dims}, got {variable.dims}"
        )
    unit = str(variable.attrs.get("units", "")).strip()
    if unit not in units:
        raise RecordingError(f"variable {name!r}: expected the unit {units[0]!r}, got {unit!r}")
    values = variable.transpose(*(dim for dim in dims if dim in variable.dims)).values
    if values.dtype.kind not in "iuf":
        raise RecordingError(f"variable {name!r}: expected real numbers, got {values.dtype.name}")
    return values - ZERO_CELSIUS if unit in KELVIN else values
