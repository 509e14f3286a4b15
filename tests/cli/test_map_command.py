"""`dipoletop map`: what it computes, prints, writes, refuses, and how it goes on."""

import jax
import numpy as np
import pytest
import zarr
from command_line import invoke, refusal, row

import dipoletop as dt
from dipoletop.cli import maps

SIZE = 24  # on both axes, everywhere, so that the engine compiles once for each level


@pytest.fixture(scope="module")
def default_map(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    return invoke("map", "--size", SIZE, "--output", folder / "m", "--quiet"), folder


@pytest.fixture(scope="module")
def basins(default_map):
    _, folder = default_map
    return [dt.Basin.load(folder / f"m-{level}.zarr") for level in ("order-1", "semi")]


def test_default_map_is_phi_and_w3_at_both_levels(default_map, basins):
    result, folder = default_map
    assert result.exit_code == 0, result.output
    assert result.stderr == ""  # --quiet
    assert (folder / "m.png").stat().st_size > 10_000
    assert [basin.level for basin in basins] == ["reduced, order 1 (the paper's)", "semi-reduced"]
    for basin in basins:
        assert basin.dims == ("delta", "w_perp", "w3", "phi")
        assert basin.shape == (1, 1, SIZE, SIZE)
        np.testing.assert_allclose(basin.coords["phi"], np.arange(SIZE) * np.pi / SIZE)
        np.testing.assert_allclose(basin.coords["w3"], np.linspace(0, 0.6, SIZE))
        assert basin.coords["delta"] == -0.2
        assert basin.coords["w_perp"] == 0.2


@pytest.mark.parametrize("level", [0, 1])
def test_labels_of_the_map_are_those_of_single_runs(basins, level):
    basin = basins[level]
    make = (dt.TransverseReduced, dt.TransverseSemi)[level]
    for i, j in ((3, 0), (3, 20), (12, 3), (20, 2), (10, 16), (0, 5)):
        w3, phi = basin.coords["w3"][i], basin.coords["phi"][j]
        one = dt.classify(make(-0.2), dt.cylindrical(0.2, w3, phi))
        assert int(one.outcome) == basin.outcome[0, 0, i, j]
        assert float(one.omega_inf) == pytest.approx(basin.omega_inf[0, 0, i, j], rel=1e-6)
    assert set(np.unique(basin.outcome)) == {dt.Outcome.RESIDUAL, dt.Outcome.STOP}


def test_printed_numbers_are_those_of_the_data(default_map, basins):
    text = default_map[0].output
    size = SIZE**2
    residual = [np.sum(basin.outcome == dt.Outcome.RESIDUAL) for basin in basins]
    assert row(text, "residual") == [f"{count / size:.2%}" for count in residual]
    differ = int(np.sum(basins[0].outcome != basins[1].outcome))
    assert differ > 0
    assert f"differs between the levels: {differ} starts, {differ / size:.2%}." in text
    still = [int(np.sum(basin.steps == 0)) for basin in basins]
    assert row(text, "decided at τ = 0") == [f"{n} starts, without a step" for n in still]
    certified = [f"{np.mean(basin.certified):.2%} of the starts" for basin in basins]
    assert row(text, "certified for its level") == certified
    # ω₃ = 0 is its own mirror image, so the plane has 2·24 × (2·24 − 1) starts.
    whole = 2 * SIZE * (2 * SIZE - 1)
    assert f"Not computed: {whole - size} of {whole} starts of the whole plane (74%)" in text
    assert all(cell.startswith(f"{size} starts in ") for cell in row(text, "computed"))
    assert all(float(cell.replace(",", "")) > 0 for cell in row(text, "starts per second"))


def test_a_second_run_reads_what_is_there(default_map, basins):
    _, folder = default_map
    again = invoke("map", "--size", SIZE, "--output", folder / "m")
    assert again.exit_code == 0
    assert row(again.output, "found in the store") == [f"{SIZE**2} starts"] * 2
    assert "computed  " not in again.output
    assert "starts per second" not in again.output
    assert row(again.output, "stop") == row(default_map[0].output, "stop")


def test_an_interrupted_map_goes_on_where_it_stopped(default_map, tmp_path):
    out = tmp_path / "m.png"
    first = invoke("map", "--level", "semi", "--size", SIZE, "--output", out)
    place = tmp_path / "m-semi.zarr"
    outcome, rows = dt.Basin.load(place).outcome, zarr.open_array(place / "outcome").chunks[-2]
    lost, tile = len(list((place / "outcome/c/0/0").iterdir())) - 1, rows * SIZE
    assert lost > 0
    for chunk in (f"outcome/c/0/0/{lost}/0", f"dipoletop-tiles/done/c/{lost}/0"):
        (place / chunk).unlink()
    again = invoke("map", "--level", "semi", "--size", SIZE, "--output", out)
    assert row(again.output, "found in the store") == [f"{lost * tile} starts"]
    assert row(again.output, "computed")[0].startswith(f"{SIZE**2 - lost * tile} starts")
    np.testing.assert_array_equal(dt.Basin.load(place).outcome, outcome)
    assert row(again.output, "stop") == row(first.output, "stop")


def test_another_map_is_not_overwritten(default_map, basins):
    _, folder = default_map
    before = basins[0].outcome
    picture = (folder / "m.png").read_bytes()
    line = refusal("map", "--size", SIZE, "--output", folder / "m", "--delta", -0.3)
    assert line == (
        f"{folder}/m-order-1.zarr holds another sweep: delta[0] is -0.2 there and -0.3 here "
        "(1 of 1 differ); choose another --output, or remove it."
    )
    assert (folder / "m.png").read_bytes() == picture
    np.testing.assert_array_equal(dt.Basin.load(folder / "m-order-1.zarr").outcome, before)


def test_every_option_of_the_map_arrives(tmp_path):
    axes = ["--x", "delta", "--y", "amplitude"]
    ranges = ["--range", "delta", -0.4, -0.1, "--range", "amplitude", 0.1, 0.3]
    fixed = ["--theta", "pi/3", "--phi", "2*pi/3"]
    settings = ["--rtol", 1e-6, "--max-steps", 777, "--confirm", 1e-9]
    files = ["--device", "cpu", "--format", "svg"]
    folder = f"{tmp_path}/new/"
    what = ["--level", "semi", "--size", f"{SIZE}x{SIZE}", "--output", folder, "--progress"]
    result = invoke("map", *what, *axes, *ranges, *fixed, *settings, *files)
    assert result.exit_code == 0, result.output
    assert result.output.startswith(
        "24 × 24 starts: δ from -0.4 to -0.1, |ω| from 0.1 to 0.3, at φ = 2π/3, ϑ = π/3."
    )
    assert "semi: 100%" in result.stderr
    assert (tmp_path / "new" / "map.svg").read_text().startswith("<?xml")
    basin = dt.Basin.load(tmp_path / "new" / "map-semi.zarr")
    assert (basin.attrs["rtol"], basin.attrs["max_steps"], basin.attrs["confirm"]) == (
        1e-6,
        777,
        1e-9,
    )
    assert basin.dims == ("phi", "theta", "amplitude", "delta")
    np.testing.assert_allclose(basin.coords["delta"], np.linspace(-0.4, -0.1, SIZE))
    np.testing.assert_allclose(basin.coords["amplitude"], np.linspace(0.1, 0.3, SIZE))
    np.testing.assert_allclose(
        [*basin.coords["theta"], *basin.coords["phi"]], [np.pi / 3, 2 * np.pi / 3]
    )
    assert row(result.output, "changed at second tolerance") == [f"{basin.changed.sum()} starts"]
    size, polar = basin.coords["amplitude"][7], np.pi / 3
    start = dt.cylindrical(size * np.sin(polar), size * np.cos(polar), 2 * np.pi / 3)
    one = dt.classify(dt.TransverseSemi(basin.coords["delta"][15]), start)
    assert int(one.outcome) == basin.outcome[0, 0, 7, 15]


def test_no_store_leaves_a_picture_only(tmp_path):
    what = ["--level", "order-1", "--x", "w-perp", "--w3", 0.1, "--y", "phi", "--size", SIZE]
    result = invoke("map", *what, "--no-store", "--output", tmp_path / "only.pdf")
    assert result.exit_code == 0, result.output
    assert [path.name for path in tmp_path.iterdir()] == ["only.pdf"]
    assert "outcomes may differ at the consistent levels" in result.output
    assert "Data:" not in result.output


@pytest.mark.parametrize(
    ("store", "kept"),
    [
        ("--store", "finished tiles are kept, and this goes on from there:\ndipoletop"),
        ("--no-store", "nothing is kept without a store.\n"),
    ],
)
def test_an_interrupt_ends_with_one_line(monkeypatch, tmp_path, store, kept):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(maps, "sweep", interrupted)
    result = invoke("map", store, "--output", tmp_path / "m")
    assert result.exit_code == 130
    assert result.stderr.startswith(f"Stopped: {kept}")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("--delta 1.5", "Argument `delta` must lie in [-1, 1), but is 1.5."),
        ("--x delta --range delta -2 0", "Argument `delta` must lie in [-1, 1), but is -2.0."),
        ("--rtol 1e-20", "must lie between 4.4e-15 and 1 in float64, but is 1e-20."),
        ("--confirm 3", "Argument `confirm` must lie between 4.4e-15 and 1 in float64, but is 3."),
        ("--phi 0.3", "--phi would fix an axis of the map; use --range phi LOW HIGH."),
        ("--x w3", "--x and --y must be two different quantities, but are both w3."),
        ("--range delta 0 0.5", "--range delta: the axes of this map are phi and w3."),
        ("--range w3 1 0", "--range w3: 1 must be less than 0."),
        (
            "--x theta --y amplitude --range theta -1 1",
            "theta must lie between 0 and pi, but is -1.",
        ),
        ("--w-perp -0.1", "w-perp must not be negative, but is -0.1."),
        ("--y amplitude --range amplitude -1 1", "amplitude must not be negative, but is -1."),
        ("--amplitude 0.3", "amplitude and w3 cannot be mixed: the start is given by w-perp and"),
        ("--level semi --level semi", "--level must be one level, or two different ones."),
        ("--device gpu", "--device gpu: JAX finds none on this machine."),
        ("--level full", "Invalid value for '--level': 'full' is not one of 'order-1'"),
        ("--w3 nan", "'nan' is not a finite number such as 0.2, 1e-3 or pi/30."),
        ("--w3 pi/0", "'pi/0' is not a finite number such as 0.2, 1e-3 or pi/30."),
        ("--size 1", "'1' is not a size such as 512 or 512x256, at least 2."),
        ("--size 5,5", "'5,5' is not a size such as 512 or 512x256, at least 2."),
        ("--max-steps 0", "Invalid value for '--max-steps'"),
        ("--format bmp", "Invalid value for '--format'"),
        ("--sizes 5", "No such option '--sizes'"),
    ],
)
def test_a_map_that_cannot_be_is_refused_in_one_line(tmp_path, arguments, line):
    if arguments == "--device gpu" and jax.default_backend() == "gpu":
        arguments, line = "--level full", "'full' is not one of"
    assert line in refusal("map", "--output", f"{tmp_path}/m", *arguments.split())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    assert "file" in refusal("map", "--output", f"{tmp_path}/file/m")


# Slow runs


@pytest.mark.slow
def test_slow_runs_are_predicted_and_counted(tmp_path):
    """A needle of which chance decides, at the amplitude of a particle; and no prediction."""
    needle = ["--level", "semi", "--delta", 0.85, "--w-perp", 1e-20, "--range", "w3", 1e-20, 3e-20]
    command = ["map", *needle, "--size", 8, "--max-steps", 100, "--output", tmp_path / "m"]
    result = invoke(*command)
    assert result.exit_code == 0, result.output
    assert row(result.output, "undecided")[0] == "100.00%"
    assert row(result.output, "predicted by the law of capture") == ["64 starts"]
    (chance,) = row(result.output, "a matter of chance")
    assert chance.startswith("64 undecided starts, residual with probability 0.7")
    basin = dt.Basin.load(tmp_path / "m-semi.zarr")
    assert abs(basin.probability.mean() - 0.778) < 0.01
    assert basin.steps.max() == 0
    assert "holds another sweep" in refusal(*command, "--slow-flow", "off")
    followed = invoke(*command[:-1], tmp_path / "off", "--slow-flow", "off")
    assert row(followed.output, "undecided")[0] == "100.00%"
    assert "predicted by" not in followed.output
    assert "slow_flow is False there and auto here" in refusal(*command[:-1], tmp_path / "off")
