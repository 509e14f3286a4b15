"""A program as users write it has no error for a type checker."""

import json
import subprocess
import sys

import pytest

PROGRAM = """
import jax
import jax.numpy as jnp
import numpy as np
import dipoletop as dt

jax.config.update("jax_enable_x64", True)
equation = dt.TransverseSemi(delta=-0.2)
omega0 = dt.cylindrical(w_perp=0.2, w3=0.2, phi=jnp.pi / 30)
trajectory = dt.simulate(equation, omega0, ts=jnp.linspace(0, 1e3, 201))
largest: float = float(trajectory.omega.max())
energies: np.ndarray = np.asarray(trajectory.energy)
dt.plots.save(dt.plots.trajectory(trajectory), "trajectory.png")
dt.plots.trajectory(trajectory).set_title("a title")
table = trajectory.to_dataframe()
print(table["omega_1"].max(), trajectory.to_xarray().omega.dims)
verdict = dt.classify(equation, omega0)
print(dt.Outcome(int(verdict.outcome)).name, float(verdict.omega_inf))
grid = dt.symmetry_cell(n_phi=32, n_w3=32, w3_max=0.6)
basin = dt.sweep(lambda w3, phi: (equation, dt.cylindrical(0.2, w3, phi)), grid)
share: float = basin.fractions()["STOP"].share
dt.plots.compare(basin, basin).savefig("both.pdf")
print(basin.outcome.shape, basin.to_dataframe().describe())
grain = dt.Particle.cuboid([1e-7, 6e-8, 4e-8], [0, 0, 8e-27], density=2000)
start = dt.particles.start(grain, "1 GHz", momentum=[1, 1, 1])
print(dt.predict(grain, start).half_time, dt.balance(grain, 1e9).dominant)
slope = jax.grad(lambda delta: dt.residual_rotation(dt.TransverseSemi(delta), omega0))(-0.2)
print(f"{slope:.4f}", dt.noise.mean_square(heat=0.25), dt.validation.environment())
"""


@pytest.mark.system
def test_a_users_program_is_checked_without_errors(tmp_path):
    file = tmp_path / "program.py"
    file.write_text(PROGRAM)
    (tmp_path / "pyrightconfig.json").write_text('{"reportMissingTypeStubs": false}')
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable]
    done = subprocess.run([*command, str(file)], cwd=tmp_path, capture_output=True, text=True)
    found = json.loads(done.stdout)["generalDiagnostics"]
    said = [f"{each['range']['start']['line']}: {each['message']}" for each in found]
    assert said == []
