"""`dipoletop map`: what it computes, prints and writes, and how it goes on."""

import re
import time

import jax
import numpy as np
import pytest
import zarr

import dipoletop as dt
from command_line import invoke, refusal, said
from dipoletop import validation
from dipoletop.cli import map_run
from dipoletop.cli.map_run import measure_compile_time

SIZE = 24  # on both axes, everywhere, so that the engine compiles once for each level


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("map")


@pytest.fixture(scope="module")
def text(folder):
    result = invoke("map", "--size", SIZE, "--output", folder / "m", "--quiet")
    assert (result.exit_code, result.stderr) == (0, "")
    return result.output


@pytest.fixture(scope="module")
def basins(folder, text):
    return [dt.Basin.load(folder / f"m-{level}.zarr") for level in ("order-1", "semi")]


def test_default_map_is_phi_and_w3_at_both_levels(folder, basins):
    assert (folder / "m.png").stat().st_size > 10_000
    assert [basin.level for basin in basins] == ["reduced, order 1 (the paper's)", "semi-reduced"]
    for basin in basins:
        assert basin.dims == ("delta", "w_perp", "w3", "phi")
        assert basin.shape == (1, 1, SIZE, SIZE)
        np.testing.assert_allclose(basin.coords["phi"], np.arange(SIZE) * np.pi / SIZE)
        np.testing.assert_allclose(basin.coords["w3"], np.linspace(0, 0.6, SIZE))
        assert basin.coords["delta"] == -0.2
        assert basin.coords["w_perp"] == 0.2


def test_printed_numbers_are_those_of_the_data(text, basins):
    size = SIZE**2
    for basin in basins:
        assert repr(basin) in text
        assert f"{np.sum(basin.steps == 0)} starts decided without a step" in text
        assert f"{np.mean(basin.steps):.1f} steps on average, at most {basin.steps.max()};" in text
        assert f"certain at τ = {np.median(basin.time):.3g} (median)" in text
    differ = int(np.sum(basins[0].outcome != basins[1].outcome))
    assert differ > 0
    assert f"differs between the levels: {differ} starts, {differ / size:.2%}." in text
    # ω₃ = 0 is its own mirror image, so the plane has 2·24 × (2·24 − 1) starts.
    whole = 2 * SIZE * (2 * SIZE - 1)
    assert f"Not computed: {whole - size} of {whole} starts of the whole plane (74%)" in text
    speeds = re.findall(rf"{size} starts computed in [\d.]+ s, ([\d,]+) per second", text)
    assert len(speeds) == 2
    assert all(float(speed.replace(",", "")) > 0 for speed in speeds)


def test_a_second_run_reads_what_is_there(folder, text, basins):
    again = said("map", "--size", SIZE, "--output", folder / "m")
    assert again.count(f"{SIZE**2} starts found in the store") == 2
    assert "starts computed" not in again
    assert all(repr(basin) in again for basin in basins)


def test_another_map_is_not_overwritten(folder, basins):
    before = basins[0].outcome
    picture = (folder / "m.png").read_bytes()
    line = refusal("map", "--size", SIZE, "--output", folder / "m", "--delta", -0.3)
    assert line == (
        f"{folder}/m-order-1.zarr holds another sweep: delta[0] is -0.2 there and -0.3 here "
        "(1 of 1 differ); choose another --output, or remove it."
    )
    assert (folder / "m.png").read_bytes() == picture
    np.testing.assert_array_equal(dt.Basin.load(folder / "m-order-1.zarr").outcome, before)


def test_outcomes_are_the_known_ones_and_a_stopped_map_goes_on(tmp_path):
    """Among the starts are those of figure 2."""
    ranges = ["--range", "phi", "pi/30", "pi/3", "--range", "w3", 0.1, 0.2]
    command = ["map", "--level", "order-1", "--size", SIZE, *ranges, "--output", tmp_path / "m.png"]
    first = said(*command)
    assert "outcomes may differ at the consistent levels" in first
    place = tmp_path / "m-order-1.zarr"
    basin = dt.Basin.load(place)
    assert basin.omega_inf[0, 0, -1, 0] == pytest.approx(validation.RESIDUAL_ROTATION, rel=1e-6)
    assert basin.outcome[0, 0, -1, -1] == dt.Outcome.STOP
    outcome, rows = basin.outcome, zarr.open_array(place / "outcome").chunks[-2]
    lost, tile = len(list((place / "outcome/c/0/0").iterdir())) - 1, rows * SIZE
    assert lost > 0
    for chunk in (f"outcome/c/0/0/{lost}/0", f"dipoletop-tiles/done/c/{lost}/0"):
        (place / chunk).unlink()
    again = said(*command)
    assert f"{lost * tile} starts found in the store" in again
    assert f"{SIZE**2 - lost * tile} starts computed" in again
    np.testing.assert_array_equal(dt.Basin.load(place).outcome, outcome)


def test_every_option_of_the_map_arrives(tmp_path):
    axes = ["--x", "delta", "--y", "amplitude"]
    ranges = ["--range", "delta", -0.4, -0.1, "--range", "amplitude", 0.1, 0.3]
    fixed = ["--theta", "pi/3", "--phi", "2*pi/3"]
    settings = ["--rtol", 1e-6, "--max-steps", 777, "--confirm", 1e-9]
    files = ["--device", "cpu", "--format", "svg"]
    what = ["--level", "semi", "--size", f"{SIZE}x{SIZE}", "--output", f"{tmp_path}/new/"]
    result = invoke("map", *what, "--progress", *axes, *ranges, *fixed, *settings, *files)
    assert result.exit_code == 0, result.output
    assert result.output.startswith(
        "24 × 24 starts: δ from -0.4 to -0.1, |ω| from 0.1 to 0.3, at φ = 2π/3, ϑ = π/3."
    )
    assert "semi: 100%" in result.stderr
    assert (tmp_path / "new" / "map.svg").read_text().startswith("<?xml")
    basin = dt.Basin.load(tmp_path / "new" / "map-semi.zarr")
    found = [basin.attrs[name] for name in ("rtol", "max_steps", "confirm")]
    assert found == [1e-6, 777, 1e-9]
    assert basin.dims == ("phi", "theta", "amplitude", "delta")
    np.testing.assert_allclose(basin.coords["delta"], np.linspace(-0.4, -0.1, SIZE))
    np.testing.assert_allclose(basin.coords["amplitude"], np.linspace(0.1, 0.3, SIZE))
    angles = [*basin.coords["theta"], *basin.coords["phi"]]
    np.testing.assert_allclose(angles, [np.pi / 3, 2 * np.pi / 3])
    assert f"{basin.changed.sum()} starts changed at the second tolerance" in result.output


def test_no_store_leaves_a_picture_only(tmp_path):
    what = ["--level", "order-1", "--x", "w-perp", "--w3", 0.1, "--y", "phi", "--size", SIZE]
    text = said("map", *what, "--no-store", "--output", tmp_path / "only.pdf")
    assert [path.name for path in tmp_path.iterdir()] == ["only.pdf"]
    assert "Data:" not in text


def test_compiling_time_is_counted_once_however_many_threads_compile():
    event = "/jax/core/compile/backend_compile_duration"
    with measure_compile_time() as seconds:
        assert seconds() == 0
        for _ in range(2):
            jax.monitoring.record_event_duration_secs(event, 0.5)
        assert 0.5 <= seconds() < 0.6
        jax.monitoring.record_event_duration_secs("/jax/checkpoint/write", 0.5)
        time.sleep(0.01)
        jax.monitoring.record_event_duration_secs(event, 0.001)
        assert 0.501 <= seconds() < 0.6
    jax.monitoring.record_event_duration_secs(event, 5.0)
    assert seconds() < 0.6


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

    monkeypatch.setattr(map_run, "sweep", interrupted)
    result = invoke("map", store, "--output", tmp_path / "m")
    assert result.exit_code == 130
    assert result.stderr.startswith(f"Stopped: {kept}")


@pytest.mark.slow
def test_slow_runs_are_predicted_and_counted(tmp_path):
    """A needle of which chance decides, at the amplitude of a particle; and no prediction."""
    needle = ["--level", "semi", "--delta", 0.85, "--w-perp", 1e-20, "--range", "w3", 1e-20, 3e-20]
    command = ["map", *needle, "--size", 8, "--max-steps", 100, "--output", tmp_path / "m"]
    text = said(*command)
    assert "UNDECIDED 100.00%" in text
    assert "64 starts predicted: UNFOLDED" in text
    assert "64 starts undecided, a matter of chance: residual with probability 0.7" in text
    basin = dt.Basin.load(tmp_path / "m-semi.zarr")
    assert abs(basin.probability.mean() - 0.778) < 0.01
    assert basin.steps.max() == 0
    assert "holds another sweep" in refusal(*command, "--slow-flow", "off")
    followed = said(*command[:-1], tmp_path / "off", "--slow-flow", "off")
    assert "UNDECIDED 100.00%" in followed
    assert "starts predicted" not in followed
    line = refusal(*command[:-1], tmp_path / "off")
    assert "slow_flow is False there and auto here" in line
