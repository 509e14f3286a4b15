"""Turns: users are served by turns, the newest work counts, and the thread ends."""

import time

import pytest

from dipoletop.explorer import fair_queue


def pieces(log, name, count, seconds=0.005):
    for k in range(count):
        time.sleep(seconds)
        log.append((name, k))
        yield 0.0


def finished(log, name, k, timeout=60.0):
    end = time.monotonic() + timeout
    while (name, k) not in log:
        assert time.monotonic() < end, log
        time.sleep(0.001)


def test_a_second_user_waits_for_a_piece_of_the_first_one_only():
    log, crew = [], fair_queue.Turns()
    crew.put("first", pieces(log, "first", 200))
    finished(log, "first", 3)
    crew.put("second", pieces(log, "second", 5))
    finished(log, "second", 4)
    turns = log[log.index(("second", 0)) : log.index(("second", 4)) + 1]
    assert len(turns) <= 9  # five of his, and at most one of the first between them
    crew.drop("first")


def test_newer_work_replaces_what_is_left_of_older_work():
    log, crew = [], fair_queue.Turns()
    crew.put("user", pieces(log, "old", 100))
    finished(log, "old", 2)
    crew.put("user", pieces(log, "new", 3))
    before = len(log)
    finished(log, "new", 2)
    assert len(log) <= before + 4  # three new pieces, and the old one under way
    time.sleep(0.05)
    assert log[-1] == ("new", 2)


def test_dropped_work_is_not_continued():
    log, crew = [], fair_queue.Turns()
    crew.put("user", pieces(log, "user", 100))
    finished(log, "user", 1)
    crew.drop("user")
    before = len(log)
    time.sleep(0.05)
    assert len(log) <= before + 1  # that under way


def test_work_that_waits_lets_others_work():
    def waiting():
        log.append(("waiting", 0))
        yield time.monotonic() + 0.2
        log.append(("waiting", 1))

    log, crew = [], fair_queue.Turns()
    crew.put("patient", waiting())
    finished(log, "waiting", 0)
    crew.put("other", pieces(log, "other", 5))
    finished(log, "waiting", 1)
    assert log.index(("other", 4)) < log.index(("waiting", 1))


def test_the_thread_ends_without_work_and_begins_again(monkeypatch):
    monkeypatch.setattr(fair_queue, "IDLE", 0.05)
    log, crew = [], fair_queue.Turns()
    for name in ("first", "second"):
        crew.put("user", pieces(log, name, 2))
        finished(log, name, 1)
        end = time.monotonic() + 60
        while crew._thread is not None:
            if time.monotonic() > end:
                pytest.fail("the thread does not end")
            time.sleep(0.01)
