"""Files of lights: written, read, and refused."""

import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.calibration.light_files import (
    read_lights,
    read_lp,
    read_rows,
    write_lights,
    write_lp,
    write_rows,
)

DIRECTIONS = np.random.default_rng(0).normal(size=(4, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


def test_lp(tmp_path):
    file, names = tmp_path / "lights.lp", ["a.png", "b c.png", "d.png", "e.png"]
    write_lp(file, names, DIRECTIONS)
    assert file.read_text().splitlines()[0] == "4"
    found, rows = read_lp(file)
    assert found == names
    np.testing.assert_allclose(rows, DIRECTIONS, atol=1e-8)
    file.write_text("1\r\nphoto.jpg   0 3e1 -40\r\n\r\n")  # positions of a dome
    assert read_lp(file)[0] == ["photo.jpg"]
    np.testing.assert_allclose(read_lp(file)[1], [[0, 0.6, -0.8]])


def test_rows(tmp_path):
    file = tmp_path / "light_intensities.txt"
    write_rows(file, 100 * DIRECTIONS)
    np.testing.assert_allclose(read_rows(file), 100 * DIRECTIONS, atol=1e-8)
    np.testing.assert_allclose(np.loadtxt(file), 100 * DIRECTIONS, atol=1e-8)


def test_lights(tmp_path):
    file = tmp_path / "lights.csv"
    lights = [
        {
            "name": "a, b.png",
            "direction": DIRECTIONS[i],
            "distance": distance,
            "color": (1.0, 0.5, 0.25),
            "std_degrees": 0.1 * i,
            "center": [1.0, 2, 3],
        }
        for i, distance in enumerate((np.inf, 5.5))
    ]
    write_lights(file, lights)
    header = "name,x,y,z,distance,red,green,blue,std_degrees,center_x,center_y,center_z"
    assert file.read_text().splitlines()[0] == header
    found = read_lights(file)
    assert [light["name"] for light in found] == ["a, b.png"] * 2
    assert [light["distance"] for light in found] == [np.inf, 5.5]
    for light, expected in zip(found, lights, strict=True):
        assert set(light) == set(expected)
        np.testing.assert_allclose(light["direction"], expected["direction"], rtol=1e-8)
        np.testing.assert_allclose(light["color"], expected["color"])
        np.testing.assert_allclose(light["center"], [1, 2, 3])
    with pytest.raises(st.InputError, match="the same fields for all"):
        write_lights(file, [{"name": "a"}, {"x": 1.0}])


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (read_lp, "", ":1: expected the number of the lines"),
        (read_lp, "2\na 0 0 1\n", ":1: expected the number of the lines that follow, 1, got '2'"),
        (read_lp, "1\na 0 0\n", ":2: expected three numbers, got '0 0'|:2: expected three"),
        (read_lp, "1\na 0 0 x\n", ":2: expected three numbers, got '0 0 x'"),
        (read_lp, "1\na 0 0 0\n", ":2: expected a direction, got three zeros"),
        (read_rows, "1 2 3\n\n1 2 nan\n", ":3: expected three numbers, got '1 2 nan'"),
        (read_lights, "", ":1: expected a header"),
        (read_lights, "name,x\na\n", ":2: expected 2 columns, got 1"),
    ],
)
def test_broken_files(tmp_path, read, text, message):
    file = tmp_path / "lights"
    file.write_text(text)
    with pytest.raises(st.InputError, match=message):
        read(file)


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(st.InputError, match="unit vectors"):
        write_lp(tmp_path / "a.lp", ["a"], np.array([[1.0, 1, 1]]))
    with pytest.raises(st.InputError, match="names: expected 4"):
        write_lp(tmp_path / "a.lp", ["a"], DIRECTIONS)
    with pytest.raises(st.InputError, match="finite"):
        write_rows(tmp_path / "a.txt", DIRECTIONS * np.nan)
    assert list(tmp_path.iterdir()) == []
