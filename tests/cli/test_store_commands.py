"""`dipoletop store`: damaged tiles are listed, and computed again."""

import numpy as np
from click.testing import CliRunner

import dipoletop as dt
from dipoletop import cli


def invoke(*arguments):
    return CliRunner().invoke(cli.main, [str(x) for x in arguments])


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def flip(file, bit):
    data = bytearray(file.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    file.write_bytes(data)


def test_verify_lists_damaged_tiles_and_repair_computes_them(tmp_path):
    made = invoke("map", "--level", "order-1", "--size", "12", "--output", tmp_path / "m.png")
    assert made.exit_code == 0, made.output
    place = tmp_path / "m-order-1.zarr"
    before = files(place)
    right = invoke("store", "verify", place)
    assert (right.exit_code, right.output) == (0, "0 of 2 tiles damaged.\n")
    flip(place / "steps/c/0/0/1/0", 99)
    (place / "dipoletop-tiles" / "done" / "c" / "0" / "0").unlink()
    wrong = invoke("store", "verify", place)
    assert wrong.exit_code == 1
    assert wrong.output.startswith("tile 1: its steps cannot be read")
    assert wrong.output.endswith("1 of 2 tiles damaged, 1 not computed yet.\n")
    again = invoke("map", "--level", "order-1", "--size", "12", "--output", tmp_path / "m.png")
    assert again.exit_code == 2
    assert "is damaged, tile 1" in again.output
    mended = invoke("store", "repair", place)
    assert mended.output == f"144 starts computed again: {place} is as it was written.\n"
    assert files(place) == before
    flip(place / "dipoletop-tiles" / "zarr.json", 3000)
    for command in ("verify", "repair"):
        assert "is damaged, metadata: its header" in invoke("store", command, place).output
    again = ("map", "--level", "order-1", "--size", "12", "--output", tmp_path / "m.png")
    assert invoke(*again, "--repair").exit_code == 0
    assert files(place) == before
    other = dt.Grid(w3=[0.1], phi=np.array([0.2]))
    dt.sweep(
        lambda w3, phi: (dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)),
        other,
        store=tmp_path / "other.zarr",
    )
    refused = invoke("store", "repair", tmp_path / "other.zarr")
    assert refused.exit_code == 2
    assert "must be the store of a `dipoletop map`, but" in refused.output
