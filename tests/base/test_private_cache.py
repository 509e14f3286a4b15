"""The cache on disk: what it gives back, and what it does not trust."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dipoletop._base import private_cache

KEY, OTHER = bytes(16), bytes(range(16))
CONTENT = b"machine code" * 100


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of an empty cache."""
    monkeypatch.delenv(private_cache.VARIABLE, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "dipoletop"


@pytest.fixture
def entry(folder):
    """The file of an entry."""
    private_cache.save(KEY, CONTENT)
    (file,) = folder.iterdir()
    return file


def test_what_is_saved_is_loaded(entry):
    assert private_cache.load(KEY) == CONTENT
    assert private_cache.load(OTHER) is None
    assert entry.parent.stat().st_mode & 0o777 == 0o700
    assert entry.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("damage", ["short", "long", "empty", "flipped", "of another key"])
def test_a_damaged_entry_is_no_entry_and_is_replaced(entry, damage):
    content = entry.read_bytes()
    if damage == "of another key":
        entry.rename(entry.with_name(OTHER.hex()))
        assert private_cache.load(OTHER) is None
        return
    damaged = {"short": content[:-1], "long": content + b"x", "empty": b""}
    damaged["flipped"] = content[:50] + bytes([content[50] ^ 1]) + content[51:]
    entry.write_bytes(damaged[damage])
    assert private_cache.load(KEY) is None
    private_cache.save(KEY, CONTENT)
    assert private_cache.load(KEY) == CONTENT


@pytest.mark.parametrize("mode", [0o770, 0o777, 0o702])
def test_a_folder_that_others_may_write_to_is_not_used(entry, mode):
    entry.parent.chmod(mode)
    assert private_cache.load(KEY) is None
    entry.unlink()
    private_cache.save(KEY, CONTENT)
    assert not list(entry.parent.iterdir())


def test_an_entry_that_others_may_write_to_is_not_used(entry):
    entry.chmod(0o622)
    assert private_cache.load(KEY) is None


def test_files_of_another_user_are_not_used(entry, monkeypatch):
    monkeypatch.setattr(os, "getuid", lambda: entry.stat().st_uid + 1)
    assert private_cache.load(KEY) is None
    private_cache.save(OTHER, CONTENT)
    assert list(entry.parent.iterdir()) == [entry]


def test_an_entry_of_another_user_in_the_own_folder_is_not_used(entry, monkeypatch):
    fstat = os.fstat

    def foreign(number):
        state = list(fstat(number))
        state[4] += 1  # the owner
        return os.stat_result(state)

    monkeypatch.setattr(os, "fstat", foreign)
    assert private_cache.load(KEY) is None


def test_links_and_pipes_are_not_entries(entry, tmp_path):
    entry.rename(tmp_path / "elsewhere")
    entry.symlink_to(tmp_path / "elsewhere")
    assert private_cache.load(KEY) is None
    entry.unlink()
    os.mkfifo(entry)
    assert private_cache.load(KEY) is None


def test_a_linked_folder_is_not_used(entry, tmp_path):
    entry.parent.rename(tmp_path / "elsewhere")
    entry.parent.symlink_to(tmp_path / "elsewhere")
    assert private_cache.load(KEY) is None


def test_where_nothing_can_be_written_there_is_no_cache(folder, monkeypatch):
    (folder.parent / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder.parent / "file" / "below"))
    private_cache.save(KEY, CONTENT)
    assert private_cache.load(KEY) is None


def test_a_disk_that_takes_no_more_leaves_nothing(entry, monkeypatch):
    def fails(source, target):
        raise OSError("No space left on device")

    monkeypatch.setattr(os, "replace", fails)
    private_cache.save(OTHER, CONTENT)
    assert list(entry.parent.iterdir()) == [entry]


@pytest.mark.parametrize("word", ["off", "0", "OFF", "no", "false"])
def test_the_variable_switches_it_off(entry, monkeypatch, word):
    monkeypatch.setenv(private_cache.VARIABLE, word)
    assert private_cache.location() is None
    assert private_cache.load(KEY) is None
    private_cache.save(OTHER, CONTENT)
    assert list(entry.parent.iterdir()) == [entry]


def test_an_entry_above_the_limit_does_not_empty_the_cache(entry, monkeypatch):
    monkeypatch.setattr(private_cache, "LIMIT", len(CONTENT) + 100)
    private_cache.save(OTHER, CONTENT + bytes(200))
    assert list(entry.parent.iterdir()) == [entry]


def test_the_oldest_entries_make_room(entry, monkeypatch):
    monkeypatch.setattr(private_cache, "LIMIT", 3 * entry.stat().st_size)
    keys = [bytes([i]) * 16 for i in range(1, 6)]
    os.utime(entry, (0, 0))
    for age, key in enumerate(keys, 1):
        private_cache.save(key, CONTENT)
        os.utime(entry.with_name(key.hex()), (age, age))
    found = [private_cache.load(key) is not None for key in (KEY, *keys)]
    assert found == [False, False, False, True, True, True]


@pytest.mark.system
def test_processes_that_write_the_same_entry_at_once(folder):
    code = f"""
from dipoletop._base import private_cache
for _ in range(200):
    private_cache.save({KEY!r}, {CONTENT!r} * 50)
    assert private_cache.load({KEY!r}) == {CONTENT!r} * 50
"""
    processes = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(3)]
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert [file.name for file in folder.iterdir()] == [KEY.hex()]


@pytest.mark.parametrize(
    ("platform", "variables", "where"),
    [
        ("linux", {"XDG_CACHE_HOME": "/x"}, "/x/dipoletop"),
        ("linux", {"XDG_CACHE_HOME": "not/absolute"}, "/home/me/.cache/dipoletop"),
        ("linux", {"XDG_CACHE_HOME": ""}, "/home/me/.cache/dipoletop"),
        ("darwin", {"XDG_CACHE_HOME": "/x"}, "/home/me/Library/Caches/dipoletop"),
        ("win32", {"LOCALAPPDATA": "/local"}, "/local/dipoletop"),
        ("win32", {"LOCALAPPDATA": ""}, "/home/me/AppData/Local/dipoletop"),
    ],
)
def test_the_folder_is_where_the_system_keeps_caches(monkeypatch, platform, variables, where):
    monkeypatch.delenv(private_cache.VARIABLE, raising=False)
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.setattr(sys, "platform", platform)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert private_cache.location() == Path(where)
