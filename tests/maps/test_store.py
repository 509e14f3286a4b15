"""Stores: whose they are, what is wrong with them, and how they are gone on with and repaired."""

import json
import os
import shutil
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import zarr
from click.testing import CliRunner

import dipoletop as dt
from dipoletop import cli
from dipoletop._maps import tiles as disk
from dipoletop._maps.problems import builder

SIZE = 12, 18  # two tiles, the second not full
GRID = dt.Grid(w3=np.linspace(0.0, 0.45, SIZE[0]), phi=np.linspace(0.0, 3.0, SIZE[1]))
KINDS = {
    "outcome": "int8",
    "omega_inf": "float64",
    "time": "float64",
    "steps": "int32",
    "certified": "bool",
    "stop": "int8",
}


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A finished store; copy it before it is harmed."""
    place = tmp_path_factory.mktemp("stores") / "good.zarr"
    dt.sweep(reduced, GRID, store=place)
    return place


@pytest.fixture
def copy(good, tmp_path):
    return shutil.copytree(good, tmp_path / "copy.zarr")


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def numbers(basin):
    """Every bit of a basin."""
    arrays = {name: basin.column(name) for name in basin.columns} | basin.coords
    return {name: (x.dtype, x.shape, x.tobytes()) for name, x in arrays.items()} | basin.attrs


def flip(file, bit):
    data = bytearray(file.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    file.write_bytes(data)


def test_what_is_stored_is_what_single_runs_find_to_the_last_bit(good):
    basin, starts = dt.Basin.load(good), GRID.points(np.arange(np.prod(SIZE)))
    omegas = jax.vmap(lambda w3, phi: reduced(w3, phi)[1])(starts["w3"], starts["phi"])
    found = dt.classify_many(dt.TransverseReduced(-0.2), omegas)
    for name, kind in KINDS.items():
        assert basin.column(name).dtype == kind
        expected = np.asarray(getattr(found, name)).astype(kind)
        assert basin.column(name).ravel().tobytes() == expected.tobytes()


class PowerCutError(Exception):
    """In the middle of writing."""


# Damage


def victims(good, kind):
    """The files of a store that hold columns, axes, records, metadata of these, or the header."""
    every = sorted(p.relative_to(good) for p in good.rglob("*") if p.is_file())
    sorts = {"columns": [], "axes": [], "records": [], "metadata": [], "header": []}
    for path in every:
        sort = "columns"
        if path.name == "zarr.json":
            sort = "metadata" if len(path.parts) > 1 else "header"
        elif path.parts[0].startswith("axis_"):
            sort = "axes"
        elif path.parts[0] == "done":
            sort = "records"
        sorts[sort].append(path)
    assert all(sorts.values())
    return sorts[kind]


def damages(good):
    """364 of them: (file, what happens to it)."""
    generator = np.random.default_rng(22)
    found = []
    for kind, count in (("columns", 120), ("axes", 60), ("records", 40), ("metadata", 44)):
        for path in generator.choice(victims(good, kind), count):
            bit = int(generator.integers(8 * (good / path).stat().st_size))
            found.append((path, lambda file, bit=bit: flip(file, bit)))
    header = good / "zarr.json"
    version = header.read_bytes().index(b'"version_jax"') + 17  # which identifies no sweep
    bits = [8 * version, *generator.integers(8 * header.stat().st_size, size=39).tolist()]
    found += [(header.relative_to(good), lambda file, bit=bit: flip(file, bit)) for bit in bits]
    every = sorted(p.relative_to(good) for p in good.rglob("*") if p.is_file())
    for path in generator.choice(every, 364 - len(found) - len(every)):
        rest = (good / path).read_bytes()
        rest = rest[: int(generator.integers(len(rest)))]
        found.append((path, lambda file, rest=rest: file.write_bytes(rest)))
    found += [(path, lambda file: file.unlink()) for path in every]
    return found


def test_none_of_364_damages_gives_a_wrong_number(good, copy):
    right, refused = numbers(dt.Basin.load(good)), []
    every = damages(good)
    assert len(every) == 364
    for path, harm in every:
        before = (copy / path).read_bytes()
        harm(copy / path)
        try:
            found = numbers(dt.Basin.load(copy))
        except ValueError as error:
            found, refused = right, [*refused, error]
        assert found == right, path
        (copy / path).write_bytes(before)
    assert len(refused) > 350  # white space in a header and the like may change
    for error in refused:
        sentence = str(error)
        assert str(copy) in sentence
        assert "\n" not in sentence
        if not isinstance(error, dt.StoreDamaged):  # as one without a record: not computed yet
            assert "lacks 1 of 2 tiles" in sentence
        else:
            assert error.path == copy
            assert f"tile {error.tiles[0]}:" if error.tiles else "metadata:" in sentence
    assert numbers(dt.Basin.load(copy)) == right


@pytest.mark.parametrize(
    "victim", ["omega_inf/c/1", "done/c/0/0", "axis_phi/c/0", "time/zarr.json", "zarr.json"]
)
@pytest.mark.parametrize("harm", [lambda file: file.unlink(), lambda file: flip(file, 200)])
def test_a_sweep_finds_damage_and_repairs_it_to_the_same_bytes(good, copy, victim, harm):
    harm(copy / victim)
    lacking = victim.startswith("done") and not (copy / victim).exists()
    if not lacking:
        with pytest.raises(dt.StoreDamaged, match=r"damaged, (tile|metadata)"):
            dt.sweep(reduced, GRID, store=copy)
    again = dt.sweep(reduced, GRID, store=copy, repair=not lacking)
    assert numbers(again) == numbers(dt.Basin.load(good))
    assert files(copy) == files(good)


def test_a_chunk_of_another_tile_or_column_is_a_damage(good, copy):
    for source, target in (("steps/c/0", "steps/c/1"), ("certified/c/0", "outcome/c/0")):
        before = (copy / target).read_bytes()
        shutil.copy(good / source, copy / target)
        with pytest.raises(dt.StoreDamaged, match=f"tile {target[-1]}: its {target[:5]}"):
            dt.Basin.load(copy)
        (copy / target).write_bytes(before)
    shutil.copy(good / "done/c/0/0", copy / "done/c/1/0")
    with pytest.raises(dt.StoreDamaged, match="tile 1: its record is not what was written"):
        dt.Basin.load(copy)
    zarr.open_group(copy, mode="r+")["axis_phi"][3] = 0.7
    with pytest.raises(dt.StoreDamaged, match="metadata: the values of phi are not what was writ"):
        dt.Basin.load(copy)


def test_what_zarr_reads_past_is_damage_too(copy):
    """The value of chunks that are missing, of which there are none."""
    file = copy / "outcome" / "zarr.json"
    file.write_text(file.read_text().replace('"fill_value": 0', '"fill_value": 1'))
    with pytest.raises(dt.StoreDamaged, match="metadata: the metadata of outcome are not as writ"):
        dt.Basin.load(copy)


def test_metadata_are_not_repaired_over_the_tiles_of_another_sweep(copy):
    flip(copy / "zarr.json", 4000)
    before = files(copy)
    with pytest.raises(ValueError, match="`store` must be new or hold this very sweep, but the me"):
        dt.sweep(lambda w3, phi: reduced(w3, phi, -0.3), GRID, store=copy, repair=True)
    assert files(copy) == before


def test_columns_of_all_zeros_are_on_disk_too(tmp_path):
    """STOP at once: ω∞ = 0 and no steps, which is no reason to write nothing."""
    place = tmp_path / "still.zarr"
    still = dt.sweep(reduced, dt.Grid(w3=0.3, phi=np.pi / 2), store=place)
    assert still.omega_inf[0, 0] == 0
    assert (place / "omega_inf" / "c" / "0").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="no such folders")
def test_a_lazy_column_knows_its_place_and_its_bits(tmp_path, monkeypatch):
    """Kept in a store whose path was relative; the process moves, then the data do."""
    monkeypatch.chdir(tmp_path)
    basin = dt.sweep(reduced, GRID, store="here.zarr")
    loaded = dt.Basin.load(b"here.zarr")
    right = dt.sweep(reduced, GRID).omega_inf
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for one in (basin, loaded):
        assert np.array_equal(one.omega_inf, right, equal_nan=True)
    flip(tmp_path / "here.zarr" / "outcome" / "c" / "1", 77)
    with pytest.raises(dt.StoreDamaged, match=r"here.zarr is damaged, tile 1: its outcome"):
        _ = loaded.outcome
    shutil.rmtree(tmp_path / "here.zarr")
    for one in (basin, loaded):
        with pytest.raises(dt.StoreDamaged, match="tile 0: its omega_inf is missing"):
            _ = one.omega_inf


def test_a_crash_between_any_two_writes_leaves_nothing_torn(good, tmp_path, monkeypatch):
    """The sweep goes on without a complaint, to the same bytes."""
    write, left = zarr.storage.LocalStore.set, [0]

    async def failing(self, key, value):
        if "/c/" in key and not key.startswith("axis_"):
            if left[0] == 0:
                raise PowerCutError
            left[0] -= 1
        await write(self, key, value)

    place = tmp_path / "torn.zarr"
    chunks = len(victims(good, "columns")) + len(victims(good, "records"))
    assert chunks == 2 * (len(dt.Basin.load(good).columns) + 1)
    for count in (1, chunks // 2 - 1, chunks // 2, chunks - 1):  # after a column, or a tile
        with monkeypatch.context() as patch:
            patch.setattr(zarr.storage.LocalStore, "set", failing)
            left[0] = count
            with pytest.raises(PowerCutError):
                dt.sweep(reduced, GRID, store=place)
        dt.sweep(reduced, GRID, store=place)
        assert files(place) == files(good)
        shutil.rmtree(place)


# Another sweep


def kept(problem, over, **settings):
    """Settings that are refused for the store of the fixture, in one sentence."""

    def sweep(place):
        dt.sweep(problem, over, store=place, **settings)

    return sweep


def grid(**axes):
    return dt.Grid(**(GRID.axes | axes))


@pytest.mark.parametrize(
    ("sweep", "said"),
    [
        (kept(reduced, GRID, rtol=1e-9), "rtol is 1e-08 there and 1e-09 here"),
        (kept(reduced, GRID, confirm=1e-9), "confirm is None there and 1e-09 here"),
        (
            kept(reduced, grid(w3=np.linspace(0.0, 0.46, 12)), atol=1e-9),
            r"atol is 0.0 there and 1e-09 here, w3\[1\] is 0.0409.* there and "
            r"0.0418.* here \(11 of 12 differ\)",
        ),
        (kept(reduced, grid(phi=[0.1])), r"shape is \[12, 18\] there and \[12, 1\] here"),
        (
            kept(lambda w3, phi: reduced(w3, phi, -0.3), GRID),
            "the program of `problem` is .{8} there and .{8} here",
        ),
        (
            kept(lambda w3, phi: (dt.TransverseSemi(-0.2), reduced(w3, phi)[1]), GRID),
            r"level is reduced, order 1 \(the paper's\) there and semi-reduced here.*`verdict`",
        ),
    ],
)
def test_a_refusal_names_what_differs_with_both_values(good, sweep, said):
    before = files(good)
    with pytest.raises(ValueError, match=f"`store` must be new or hold this very sweep, .*{said}"):
        sweep(good)
    assert files(good) == before


def test_one_edited_point_of_many_is_seen(tmp_path):
    """Between the points that a glance would look at; its value is named."""
    w3 = np.linspace(0.0, 0.4, 300)
    dt.sweep(reduced, dt.Points(w3=w3, phi=w3), store=tmp_path / "a.zarr")
    w3 = w3.copy()
    w3[101] = 0.25
    message = r"w3\[101\] is 0.135.* there and 0.25 here \(1 of 300 differ\), phi\[101\]"
    with pytest.raises(ValueError, match=message):
        dt.sweep(reduced, dt.Points(w3=w3, phi=w3), store=tmp_path / "a.zarr")


def test_seed_and_draw_of_a_sample_are_seen(tmp_path):
    def problem(omega0):
        return dt.TransverseReduced(-0.2), omega0

    def sweep(**of):
        dt.sweep(problem, dt.Sample(n=5, **of), store=tmp_path / "s.zarr")

    sweep(amplitude=0.2, seed=1)
    sweep(amplitude=0.2, seed=1)
    with pytest.raises(ValueError, match=r"another sweep: seed is 1 there and 2 here"):
        sweep(amplitude=0.2, seed=2)
    with pytest.raises(ValueError, match=r"amplitude is 0.2 there and 0.3 here"):
        sweep(amplitude=0.3, seed=1)
    with pytest.raises(ValueError, match="the program of `draw` is"):
        sweep(seed=1, draw=dt.uniform_box([0, 0, 0], [1, 1, 1]))


def programs(problem):
    return builder(problem, GRID).programs()


def named(factor):
    """An equation whose class is always called the same, whatever its rates."""

    class Top(dt.TransverseReduced):
        def __call__(self, t, y, args=None):
            return factor * y

    return lambda w3, phi: (Top(-0.2), dt.cylindrical(0.2, w3, phi))


def helped(name):
    """A problem with a compiled helper of that name."""

    def half(x):
        return 0.5 * x

    half.__name__ = name
    compiled = jax.jit(half)
    return lambda w3, phi: reduced(compiled(w3), phi)


def test_a_program_is_known_by_what_it_computes_not_by_what_it_is_called():
    def another_name(w3, phi):
        azimuth = phi  # and another line
        return [dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, azimuth)]

    def banded(size):
        table = np.array([0.0, 0.0, size])

        def problem(w3, phi):
            more = jnp.where((w3 > 0.201) & (w3 < 0.202), jnp.asarray(table)[2], 0.0)
            return dt.TransverseReduced(-0.2), dt.cylindrical(0.2 + more, w3, phi)

        return problem

    usual = programs(reduced)
    assert programs(another_name) == usual
    assert programs(banded(0.1)) == programs(banded(0.1))
    assert programs(banded(0.1))["problem"] != programs(banded(0.2))["problem"]
    assert programs(helped("one")) == programs(helped("other")) != usual
    plain, again, slower = (programs(named(factor)) for factor in (1.0, 1.0, 0.5))
    assert plain == again
    assert [name for name in plain if plain[name] != slower[name]] == ["field"]


def test_another_jax_may_be_why_a_program_differs(copy):
    """The store says that an older JAX made it."""
    rewrite(copy, attrs=json.loads(old_attrs(copy)))
    message = r"\(JAX 0.0.1 traced it there and JAX .* here, which may differ by that alone\)"
    with pytest.raises(ValueError, match=message):
        dt.sweep(lambda w3, phi: reduced(w3, phi, -0.3), GRID, store=copy)
    dt.sweep(reduced, GRID, store=copy)  # which differs by nothing else


def old_attrs(place):
    attrs = zarr.open_group(place, mode="r").attrs["attrs"]
    return json.dumps({**attrs, "version_jax": "0.0.1"})


def rewrite(place, **changes):
    """Change a header as a program would that knows its digest."""
    group = zarr.open_group(place, mode="r+")
    header = {**{k: v for k, v in group.attrs.items() if k != "digest"}, **changes}
    group.attrs.update({**header, "digest": disk.header_digest(header)})


def test_what_no_trace_shows_is_seen_in_the_starts_of_a_tile(tmp_path):
    """A number that the problem reads at run time."""
    size = [0.2]

    def read(w3):
        return np.full_like(w3, size[0])

    def problem(w3, phi):
        shape = jax.ShapeDtypeStruct(w3.shape, w3.dtype)
        w_perp = jax.pure_callback(read, shape, w3, vmap_method="expand_dims")
        return dt.TransverseReduced(-0.2), dt.cylindrical(w_perp, w3, phi)

    dt.sweep(problem, GRID, store=tmp_path / "c.zarr")
    dt.sweep(problem, GRID, store=tmp_path / "c.zarr")
    size[0] = 0.21
    with pytest.raises(ValueError, match=r"in tile . of .*c.zarr the equations or starts are oth"):
        dt.sweep(problem, GRID, store=tmp_path / "c.zarr")


# Version 1


@pytest.fixture
def version_1(good, tmp_path):
    """What `dipoletop basin, version 1` was: flags, and no checksum of anything."""
    place, basin = tmp_path / "old.zarr", dt.Basin.load(good)
    group = zarr.open_group(place, mode="w")
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name, kind in KINDS.items():
            array = group.create_array(name, shape=(216,), chunks=(128,), dtype=kind)
            array[:] = basin.column(name).ravel()
        for name, values in basin.coords.items():
            group.create_array(f"axis_{name}", data=values, chunks=values.shape)
        group.create_array("done", shape=(2,), chunks=(1,), dtype="uint8")[:] = 1
    header = {"format": "dipoletop basin, version 1", "axes": ["w3", "phi"], "tile": 128}
    header |= {"dims": ["w3", "phi"], "shape": [12, 18], "columns": list(KINDS)}
    group.attrs.update({**header, "attrs": basin.attrs, "fingerprint": "f00"})
    return place


def test_a_store_of_version_1_is_read_but_not_gone_on_with(good, version_1):
    before = files(version_1)
    old = dt.Basin.load(version_1)
    right = numbers(dt.Basin.load(good))
    assert numbers(old) == {name: right[name] for name in numbers(old)}
    message = "must be new or a dipoletop basin, version 2, to go on with it, but .* version 1"
    for repair in (False, True):
        with pytest.raises(ValueError, match=message):
            dt.sweep(reduced, GRID, store=version_1, repair=repair)
    assert files(version_1) == before
    message = r"`name` must be a column of this basin \(outcome, .*\), but is 'omega_inf_error'"
    with pytest.raises(ValueError, match=message):
        old.column("omega_inf_error")


@pytest.mark.parametrize("victim", ["stop/c/1", "axis_phi/c/0", "time/zarr.json", "zarr.json"])
def test_what_is_missing_in_a_store_of_version_1_is_damage(version_1, victim):
    old = dt.Basin.load(version_1)
    (version_1 / victim).unlink()
    with pytest.raises(dt.StoreDamaged, match="tile 1" if victim == "stop/c/1" else "metadata"):
        dt.Basin.load(version_1)
    if victim == "stop/c/1":
        with pytest.raises(dt.StoreDamaged, match="tile 1: its stop is missing"):
            _ = old.stop


# Paths


@pytest.mark.parametrize(
    ("path", "said"),
    [
        (5, "be a path, but is 5"),
        ("link", "be a path to a folder, but .*link is a link to nothing"),
        ("n" * 300, "be a path where a folder can be made, but .* is not: File name too long"),
        ("nul\0", "be a path where a folder can be made, but .* is not: .*null"),
        ("file/store", "be a path where a folder can be made, but .* is not: .*(directory|exists)"),
        ("file", "be a folder with a basin, but .*file cannot be read as one"),
    ],
)
def test_a_path_that_cannot_be_is_refused(tmp_path, monkeypatch, path, said):
    monkeypatch.chdir(tmp_path)
    os.symlink("nowhere", "link")
    (tmp_path / "file").write_text("hello")
    before = files(tmp_path)
    with pytest.raises(ValueError, match=f"`store` must {said}"):
        dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=path)
    assert files(tmp_path) == before


@pytest.mark.parametrize("path", ["n" * 255, b"bytes.zarr"])
def test_long_names_and_bytes_are_paths(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    basin = dt.sweep(reduced, dt.Grid(w3=0.2, phi=0.1), store=path)
    assert numbers(dt.Basin.load(path)) == numbers(basin)
    assert len(os.listdir(tmp_path)) == 1


# No silent hang


ALONE = """
import multiprocessing, os, sys, warnings
import jax
jax.config.update("jax_enable_x64", True)
import dipoletop as dt
from dipoletop._maps.problems import builder
warnings.simplefilter("ignore")  # JAX's and Python's own, at the fork

equation, omega0 = dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, 0.1)
grid = dt.Grid(w3=[0.1, 0.2], phi=0.2)

def reduced(w3, phi):
    return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, w3, phi)

def asks_classify_many(w3, phi):
    dt.classify_many(equation, omega0[None])
    return reduced(w3, phi)

def asks_sweep(w3, phi):
    dt.sweep(reduced, grid)
    return reduced(w3, phi)

def said(call):
    try:
        call()
    except (ValueError, RuntimeError) as error:
        return str(error)
    return "nothing"

for problem in (asks_classify_many, asks_sweep):
    print(said(lambda: dt.sweep(problem, grid)))
calls = [
    lambda: dt.classify(equation, omega0),
    lambda: dt.classify_many(equation, omega0[None]),
    lambda: dt.simulate(equation, omega0, [0.0, 1.0]),
    lambda: dt.sweep(reduced, grid),
    lambda: dt.residual_rotation(equation, omega0),
    lambda: dt.spectrum(equation, [0.1, 0.0, 0.0]),
    lambda: dt.TransverseReduced(0.1),
]
omega0 = jax.device_get(omega0)
sys.stdout.flush()
if not os.fork():
    for call in calls:
        print(said(call))
    sys.stdout.flush()
    os._exit(0)
os.wait()
print(builder(reduced, dt.Grid(w3=[0.1], phi=0.2)).programs()["verdict"].hex())
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_what_would_wait_for_ever_is_refused():
    run = subprocess.run(
        [sys.executable, "-c", ALONE], capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    *lines, verdict = run.stdout.splitlines()
    nested, forked = lines[:2], lines[2:]
    assert len(forked) == 7
    for line in nested:
        assert line.startswith("Argument `problem` must not itself call `sweep` or `classify_many`")
    for line in forked:
        assert 'start it by multiprocessing.get_context("spawn") instead.' in line
    # A program has the same digest in another process, whatever that did before.
    assert verdict == programs(reduced)["verdict"].hex()


# Devices, and what a problem may return


@pytest.mark.parametrize("devices", ["gpu", [], ["cpu"]])
def test_devices_are_those_of_jax(devices):
    with pytest.raises(ValueError, match="`devices` must list at least one of JAX's devices, as"):
        dt.sweep(reduced, GRID, devices=devices)


def test_a_problem_returns_what_classify_takes():
    at = dt.Grid(w3=[0.1, 0.3], phi=[0.2, 1.2])
    expected = numbers(dt.sweep(lambda w3, phi: (dt.TransverseReduced(-0.2), W(w3)), at))
    found = dt.sweep(lambda w3, phi: [dt.TransverseReduced(-0.2), [0.2, 0, w3]], at)
    assert numbers(found) == expected
    fixed = dt.sweep(lambda w3, phi: (dt.TransverseReduced(-0.2), np.array([0.2, 0, 0.1])), at)
    assert np.array_equal(fixed.omega_inf, np.full((2, 2), found.omega_inf[0, 0]))


def W(w3):
    return jnp.stack([jnp.full_like(w3, 0.2), jnp.zeros_like(w3), w3])


# Command line


def test_verify_lists_damaged_tiles_and_repair_mends_them(good, tmp_path, monkeypatch):
    def invoke(*arguments):
        return CliRunner().invoke(cli.main, [str(x) for x in arguments])

    monkeypatch.setattr(cli.commands, "_draw", lambda *_: None)

    made = invoke("map", "--level", "order-1", "--size", "12", "--output", tmp_path / "m.png")
    assert made.exit_code == 0, made.output
    place = tmp_path / "m-order-1.zarr"
    before = files(place)
    right = invoke("store", "verify", place)
    assert (right.exit_code, right.output) == (0, "0 of 2 tiles damaged.\n")
    flip(place / "steps" / "c" / "1", 99)
    (place / "done" / "c" / "0" / "0").unlink()
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
    flip(place / "zarr.json", 3000)
    for command in ("verify", "repair"):
        assert "is damaged, metadata: its header" in invoke("store", command, place).output
    again = ("map", "--level", "order-1", "--size", "12", "--output", tmp_path / "m.png")
    assert invoke(*again, "--repair").exit_code == 0
    assert files(place) == before
    other = shutil.copytree(good, tmp_path / "other.zarr")
    refused = invoke("store", "repair", other)
    assert refused.exit_code == 2
    assert "must be the store of a `dipoletop map`, but" in refused.output
