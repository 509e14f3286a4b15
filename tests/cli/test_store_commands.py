"""`dipoletop store`: damaged tiles are listed, and computed again."""

import dataclasses

import dipoletop as dt
from command_line import invoke, refusal, said
from stored_files import files, flip


def test_verify_lists_damaged_tiles_and_repair_computes_them(tmp_path):
    command = "map", "--level", "order-1", "--size", 12, "--output", tmp_path / "m.png"
    said(*command)
    place = tmp_path / "m-order-1.zarr"
    before = files(place)
    assert said("store", "verify", place) == "0 of 2 tiles damaged.\n"
    flip(place / "steps/c/0/0/1/0", 99)
    (place / "dipoletop-tiles" / "done" / "c" / "0" / "0").unlink()
    wrong = invoke("store", "verify", place)
    assert wrong.exit_code == 1
    assert wrong.output.startswith("tile 1: its steps cannot be read")
    assert wrong.output.endswith("1 of 2 tiles damaged, 1 not computed yet.\n")
    assert "is damaged, tile 1" in refusal(*command)
    mended = said("store", "repair", place)
    assert mended == f"144 starts computed again: {place} is as it was written.\n"
    assert files(place) == before
    flip(place / "dipoletop-tiles" / "zarr.json", 3000)
    for what in ("verify", "repair"):
        assert "is damaged, metadata: its header" in invoke("store", what, place).output
    said(*command, "--repair")
    assert files(place) == before
    basin = dt.Basin.load(place)
    other = dataclasses.replace(basin, attrs=basin.attrs | {"level": "of another equation"})
    other.save(tmp_path / "other.zarr")
    line = refusal("store", "repair", tmp_path / "other.zarr")
    assert "must be the store of a `dipoletop map`, but" in line
