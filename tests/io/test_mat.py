"""The authors' MATLAB files, made here with scipy in both layouts."""

import io
import struct
import tracemalloc

import numpy as np
import pytest
import scipy.io

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment, _mat, column_names, read_recording

TWO_CELL = "peltierMIMOStepSecA.mat"


def mat(compressed: bool = True, **variables) -> bytes:
    """The bytes of a MATLAB 5 file."""
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables, do_compression=compressed)
    return stream.getvalue()


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def controller_object(name: str) -> bytes:
    """A transfer function as MATLAB saves it: an object whose name scipy takes for 'None'."""
    reference = (
        element(6, struct.pack("<II", 13, 0))
        + element(5, struct.pack("<ii", 6, 1))
        + element(1, b"")
        + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    )
    texts = b"".join(element(1, text.encode()) for text in (name, "MCOS", "tf"))
    return element(14, element(6, struct.pack("<II", 17, 0)) + texts + element(14, reference))


@pytest.fixture
def write(tmp_path):
    """Puts bytes into a file and gives its path."""

    def write(name: str, content: bytes):
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return write


@pytest.mark.parametrize(
    ("zone", "channels"),
    [
        ("A", ("T12", "T11", "TAM", "T22", "T21")),
        ("B", ("T14", "T13", "TBM", "T24", "T23")),
        ("C", ("T16", "T15", "TCM", "T26", "T25")),
    ],
)
def test_two_cells_by_zone(write, two_cell_simout, zone, channels):
    """Columns 5 to 9 are second and first upper zone, tap, second and first lower zone."""
    experiment = read_recording(write(f"StepSec{zone}.mat", mat(simout=two_cell_simout)))
    assert experiment.channels == channels
    np.testing.assert_array_equal(experiment.temperatures, two_cell_simout[:, 4:9])
    np.testing.assert_array_equal(experiment.time, two_cell_simout[:, 2])
    np.testing.assert_array_equal(experiment.duty, two_cell_simout[:, 9:11] / 255)
    assert experiment.ambient is None
    assert experiment.name == f"StepSec{zone}"


def test_one_cell(write, one_cell_simout):
    """Drive from -255 to 255, temperature, time; positive drive heats."""
    experiment = read_recording(write("BMData1_022722.mat", mat(simout=one_cell_simout)))
    assert experiment.channels == ("T",)
    np.testing.assert_array_equal(experiment.temperatures, one_cell_simout[:, 1:2])
    np.testing.assert_array_equal(experiment.time, one_cell_simout[:, 2])
    np.testing.assert_array_equal(experiment.duty, one_cell_simout[:, :1] / 255)


def test_counts_and_polarity(write, one_cell_simout):
    path = write("a.mat", mat(simout=one_cell_simout))
    experiment = read_recording(path, counts=1023, polarity=-1)
    np.testing.assert_array_equal(experiment.duty, -one_cell_simout[:, :1] / 1023)


@pytest.mark.parametrize("compressed", [True, False])
def test_objects_of_the_controller_beside_it_are_left_alone(write, two_cell_simout, compressed):
    """The authors' files hold objects that older versions of scipy name 'None', twice."""
    content = mat(compressed, alpha=1.02, simout=two_cell_simout, tout=np.arange(40))
    content = content[:128] + controller_object("M") + controller_object("Md") + content[128:]
    experiment = read_recording(write(TWO_CELL, content))
    np.testing.assert_array_equal(experiment.temperatures, two_cell_simout[:, 4:9])


@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_any_number_type_is_read_as_scipy_reads_it(write, compressed, dtype):
    k = np.arange(30)
    simout = np.stack([k, 20 + k % 7, k, k], axis=1).astype(dtype)
    content = mat(compressed, simout=simout)
    oracle = scipy.io.loadmat(io.BytesIO(content))["simout"]
    experiment = read_recording(write("a.mat", content))
    np.testing.assert_array_equal(experiment.temperatures, oracle[:, 1:2])
    np.testing.assert_array_equal(experiment.duty, oracle[:, :1].astype(float) / 255)


def test_big_endian(write):
    """MATLAB on older workstations: every number byte-swapped, the mark MI instead of IM."""

    def big(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    k = np.arange(3.0)
    simout = np.stack([k, 20 + k, k, k], axis=1)
    matrix = (
        big(6, struct.pack(">II", 6, 0))
        + big(5, struct.pack(">ii", 3, 4))
        + big(1, b"simout")
        + big(9, simout.astype(">f8").tobytes(order="F"))
    )
    content = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + big(14, matrix)
    assert scipy.io.loadmat(io.BytesIO(content))["simout"].tolist() == simout.tolist()
    np.testing.assert_array_equal(read_recording(write("a.mat", content)).time, k)


def test_another_variable_is_unpacked_in_pieces(write, two_cell_simout):
    """30 MB of zeros are 30 kB in the file."""
    content = mat(simout=two_cell_simout, zeros=np.zeros((1000, 4000)))
    path = write(TWO_CELL, content)
    tracemalloc.start()
    experiment = read_recording(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(experiment.time) == len(two_cell_simout)
    assert peak < 8e6


def test_a_matrix_beyond_all_recordings_is_refused(write, monkeypatch, two_cell_simout):
    monkeypatch.setattr(_mat, "MAX_MATRIX", 1 << 10)
    with pytest.raises(RecordingError, match="variable 'simout': expected at most 0 MiB"):
        read_recording(write(TWO_CELL, mat(simout=two_cell_simout)))


def test_time_need_not_start_at_zero_and_may_jitter(write, two_cell_simout):
    simout = two_cell_simout.copy()
    simout[:, 2] += 60 + 0.01 * np.sin(np.arange(len(simout)))
    experiment = read_recording(write(TWO_CELL, mat(simout=simout)))
    np.testing.assert_array_equal(experiment.time, simout[:, 2])


def test_the_content_says_what_it_is_whatever_the_ending(write, one_cell_simout):
    path = write("a.dat", mat(simout=one_cell_simout))
    assert read_recording(path).channels == ("T",)


@pytest.mark.parametrize(
    ("name", "zone", "channel"),
    [
        ("peltierMIMOStepSecB.mat", None, "TBM"),
        ("peltiermimostepsecb.mat", None, "TBM"),
        ("peltierMIMOSecC1.mat", None, "TCM"),
        ("full power, section A.mat", None, "TAM"),
        ("zone_c-2.mat", None, "TCM"),
        ("run.mat", "b", "TBM"),
        ("peltierMIMOStepSecA.mat", "C", "TCM"),
    ],
)
def test_the_zone_comes_from_the_name_or_the_argument(write, two_cell_simout, name, zone, channel):
    path = write(name, mat(simout=two_cell_simout))
    assert channel in read_recording(path, zone=zone).channels


@pytest.mark.parametrize("name", ["run.mat", "second.mat", "SecD.mat", "SecA and SecB.mat"])
def test_a_name_without_one_zone_asks_for_the_argument(write, two_cell_simout, name):
    with pytest.raises(RecordingError, match="pass zone='A', 'B' or 'C'"):
        read_recording(write(name, mat(simout=two_cell_simout)))


def test_a_zone_that_there_is_not(write, two_cell_simout, one_cell_simout):
    path = write(TWO_CELL, mat(simout=two_cell_simout))
    with pytest.raises(RecordingError, match=r"zone: .* got 'D'"):
        read_recording(path, zone="D")
    path = write("BMData1.mat", mat(simout=one_cell_simout))
    with pytest.raises(RecordingError, match="'simout' has 4 columns"):
        read_recording(path, zone="A")


def changed(simout: np.ndarray, row: int, column: int, value: float) -> np.ndarray:
    simout = simout.copy()
    simout[row, column] = value
    return simout


@pytest.mark.parametrize(
    ("row", "column", "value", "said"),
    [
        (7, 9, 256, "PWM of cell 1: expected -255 to 255 counts, got 256 at sample 7"),
        (7, 10, -300, "PWM of cell 2: .* got -300 at sample 7"),
        (7, 9, np.nan, "duty of P1: .* got nan at sample 7"),
        (7, 6, 293.15, "temperature: .* got 293.15 degC in row 8"),
        (7, 2, np.nan, "time: .* got nan at sample 7"),
        (7, 2, 6, "time: expected increasing times, got 6 s at sample 7 after 6 s"),
    ],
)
def test_one_wrong_number_is_named_with_its_place(write, two_cell_simout, row, column, value, said):
    path = write(TWO_CELL, mat(simout=changed(two_cell_simout, row, column, value)))
    with pytest.raises(RecordingError, match=said) as caught:
        read_recording(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_temperature_that_is_nan_is_missing(write, two_cell_simout):
    path = write(TWO_CELL, mat(simout=changed(two_cell_simout, 7, 6, np.nan)))
    assert np.argwhere(~read_recording(path).sampled).tolist() == [[7, 2]]


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({}, "expected variables that are vectors of numbers, got none"),
        ({"simouts": np.zeros((9, 11))}, "must name the columns, .* got 'simouts_1,simouts_2"),
        ({"simout": np.zeros((9, 5))}, r"expected 11 columns .* got shape \(9, 5\)"),
        ({"simout": np.zeros((11, 40))}, r"shape \(11, 40\)"),
        ({"simout": np.zeros((9, 11, 2))}, r"shape \(9, 11, 2\)"),
        ({"simout": np.zeros((0, 11))}, "empty: expected at least 2 samples, got 0"),
        ({"simout": np.zeros((1, 11))}, "empty: expected at least 2 samples, got 1"),
        ({"simout": np.zeros((9, 11), complex)}, "a matrix of real numbers, got"),
        ({"simout": np.zeros((9, 11), bool)}, "a matrix of real numbers, got"),
        ({"simout": "text"}, "a matrix of real numbers, got"),
        ({"simout": {"time": np.zeros(3)}}, "a matrix of real numbers, got"),
        ({"simout": np.array([1, "a"], object)}, "a matrix of real numbers, got"),
        ({"simout": scipy.sparse.csc_array(np.eye(11))}, "a matrix of real numbers, got"),
    ],
)
def test_a_variable_that_is_no_recording(write, variables, said):
    with pytest.raises(RecordingError, match=said):
        read_recording(write(TWO_CELL, mat(**variables)))


def test_a_damaged_file_of_matlab_7_3_is_refused(write):
    content = b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM"
    for text in (content, content.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n"):
        with pytest.raises(RecordingError, match=r"is a damaged file of MATLAB 7\.3"):
            read_recording(write(TWO_CELL, text))


@pytest.mark.parametrize(("counts", "polarity"), [(0, 1), (-255, 1), (255, 0), (255, 2)])
def test_counts_and_polarity_must_make_sense(write, one_cell_simout, counts, polarity):
    path = write("a.mat", mat(simout=one_cell_simout))
    with pytest.raises(RecordingError, match=r"expected .*, got "):
        read_recording(path, counts=counts, polarity=polarity)


VARIABLES = {
    "t": np.arange(4.0)[:, None],
    "heater": np.array([[0, 1, 1, 0]], bool),
    "y_degF": np.array([[68.0, 70.0, 72.0, 68.0]]).T,
    "probes": np.arange(8.0).reshape(4, 2) + 20,
    "Ts": np.array([[1.0]]),
    "title": "bench",
}
NAMES = {"t": "time_s", "heater": "duty_P1", "y_degF": "T1", "probes_2": "ambient"}


def check_plain(run: Experiment) -> None:
    assert run.time.tolist() == [0, 1, 2, 3]
    assert run.duty[:, 0].tolist() == [0, 1, 1, 0]
    assert run.temperatures is not None
    np.testing.assert_allclose(run.temperatures[:, 0], [20, 190 / 9, 200 / 9, 20])
    assert np.asarray(run.ambient).tolist() == [21, 23, 25, 27]


@pytest.mark.parametrize("compressed", [True, False])
def test_variables_of_any_names_are_columns(write, compressed):
    path = write("run.mat", mat(compressed, **VARIABLES))
    check_plain(read_recording(path, columns=NAMES, ignore=["probes_1"]))
    with pytest.raises(RecordingError, match="titles of the file, t, heater, y_degF, probes_1"):
        read_recording(path, columns={"time": "time_s"})


def test_variables_of_matlab_7_3_and_of_a_structure(tmp_path):
    """HDF5 as MATLAB writes it: matrices transposed, structures as groups, behind a header."""
    import h5py

    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in VARIABLES.items():
            if not isinstance(values, str):
                file[name] = values.T.astype(np.float64)
        file["log/T2"] = np.arange(4.0)[None, :]
        file["#refs#/a"] = np.arange(4.0)[None, :]
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + content[128:])
    check_plain(read_recording(path, columns=NAMES, ignore=["probes_1", "log.T2"]))
    assert "log.T2" in column_names(path)
    assert "#refs#.a" not in column_names(path)


def test_a_file_of_the_authors_may_be_read_by_names_too(write, one_cell_simout):
    path = write("run.mat", mat(simout=one_cell_simout))
    names = {"simout_1": "pwm_P1", "simout_2": "T", "simout_3": "time_s"}
    named = read_recording(path, columns=names, ignore=["*"], counts=255)
    assert named == read_recording(path)
