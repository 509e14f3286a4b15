"""Runs of a map: compile time is the union of the intervals in which threads compile."""

import time

import jax

from dipoletop.cli.maps import measure_compile_time


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
