"""Arrays in groups and structures: chosen by one path or by the groups around them, and what is left out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import find_format
from accelcal_cli.pipeline.options import field_values
from tests.cli.run import run
from tests.formats import make_mat
from tests.formats.make_hdf5 import read as read_of
from tests.formats.reading import Read
from tests.formats.table_values import values

Variables = dict[str, Any]


def nested(variables: Variables) -> Variables:
    """Arrays by their paths as structures within structures."""
    made: Variables = {}
    for path, value in variables.items():
        *groups, name = path.split("/")
        inside = made
        for group in groups:
            inside = inside.setdefault(group, {})
        inside[name] = value
    return made


def mat(path: Path, variables: Variables, objects: bool) -> None:
    elements = [make_mat.matrix(name, value) for name, value in nested(variables).items()]
    if objects:
        elements.append(make_mat.array(make_mat.CELL, (1, 1), "diary", make_mat.matrix("", values())))
        kinds = make_mat.element(1, b"MCOS") + make_mat.element(1, b"timetable")
        head = make_mat.element(6, np.array([make_mat.OPAQUE, 0], "u4").tobytes())
        data = head + make_mat.element(1, b"readings") + kinds + make_mat.matrix("", np.arange(6, dtype="u4"))
        elements.append(np.array([14, len(data)], "u4").tobytes() + data)
    path.write_bytes(make_mat.file_of(elements))


def hdf5(path: Path, variables: Variables, objects: bool) -> None:
    with h5py.File(path, "w") as file:
        for name, value in variables.items():
            file[name] = value
        if objects:
            file["readings"] = np.arange(6, dtype="u4").reshape(6, 1)
            file["readings"].attrs["MATLAB_object_decode"] = np.int32(3)
            file["diary"] = np.zeros(9, [("x", "f8"), ("y", "f8")])


def npz(path: Path, variables: Variables, objects: bool) -> None:
    odd = {"readings": np.array([{}, {}]), "diary": np.zeros(9, [("x", "f8")])} if objects else {}
    np.savez(path, **variables, **odd, allow_pickle=True)


WRITERS = {".mat": mat, ".h5": hdf5, ".npz": npz}
Make = Callable[..., Path]


@pytest.fixture(params=WRITERS, ids=lambda suffix: suffix[1:])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Make:
    """Writes a file of arrays by their paths."""

    def made(variables: Variables, objects: bool = False) -> Path:
        path = tmp_path / f"made{request.param}"
        WRITERS[request.param](path, {"fs": 50.0, "unit": "g"} | variables, objects)
        return path

    return made


def read(path: Path, **options: Any) -> Read:
    return read_of(path, 250, find_format(path, ReadOptions(**options)), **options)


def rejected(path: Path, **options: Any) -> str:
    with pytest.raises((UnreadableError, UsageError)) as caught:
        read(path, **options)
    return str(caught.value)


@pytest.mark.parametrize("upright", [True, False], ids=["rows", "on end"])
def test_t18_one_path_names_an_array_of_three(make: Make, upright: bool) -> None:
    path = make({"walk/signal": values() if upright else values().T})
    assert "as in --columns walk/signal; " in rejected(path)
    columns = field_values({"columns": "walk/signal"}, ReadOptions)["columns"]
    assert (read(path, columns=columns).g == values()).all()


def test_t18_the_command_takes_one_path(make: Make, capsys: pytest.CaptureFixture[str]) -> None:
    path = make({"walk/signal": values(), "walk/turns": values()})
    assert run(capsys, "inspect", path, "--columns", "walk/signal").code == 0
    ran = run(capsys, "inspect", path, "--columns", "walk/signal,walk/turns")
    assert ran.code == 2 and "is not three names separated by commas, nor one" in ran.err


@pytest.mark.parametrize("value", [["a"], "a", "a,a,a", ("a", "a", "a"), " a , a,a"])
def test_t18_files_and_python_name_one_column_too(value: Any) -> None:
    assert field_values({"columns": value}, ReadOptions)["columns"] == ("a", "a", "a")


def test_t18_a_path_of_groups_is_a_sensor(make: Make) -> None:
    trials = {f"Test{test}/Trial{trial}/accel": values() * (1 + test * trial / 1e3) for test, trial in
              [(5, 1), (5, 2), (6, 1)]}  # fmt: skip
    path = make(trials)
    assert "choose one, such as --columns Test5/Trial1/accel" in rejected(path)
    for sensor in ("Test5/Trial1", "/test5/trial1/", "Test5/Trial1/"):
        assert (read(path, sensor=sensor).g[:, 0] == np.rint(values()[:, 0] * 1.005 * 2**24) / 2**24).all()
    assert (read(path, sensor="Trial2").g == read(path, columns=("Test5/Trial2/accel",) * 3).g).all()
    assert "several" in rejected(path, sensor="Trial1")
    with pytest.raises(UnreadableError) as error:
        read(path, sensor="each")  # as a study does to list them
    assert error.value.sensors == ("Test5/Trial1", "Test5/Trial2", "Test6/Trial1")
    assert (read(path, sensor="Test6/Trial1,each").g == read(path, sensor="Test6/Trial1").g).all()
    assert "several" in rejected(path, sensor="est5/Trial1")


def test_t18_what_is_no_array_is_named_and_the_hint_stays(make: Make) -> None:
    path = make({"signal": values()}, objects=True)
    for options in ({}, {"columns": ("readings",) * 3}):
        message = rejected(path, **options)
        assert "signal (600 x 3)" in message
        assert "/diary, /readings cannot be read (tables, timetables, cells and dates are objects)" in message
    assert "as in --columns signal; " in rejected(path)
    assert (read(path, columns=("signal",) * 3).g == values()).all()


def test_t18_nothing_but_objects(make: Make) -> None:
    assert "/diary, /readings cannot be read" in rejected(make({}, objects=True))
