"""Work of several users in turn, a piece of each, so that nobody waits for all of another's."""

import threading
import time
from collections.abc import Hashable, Iterator

IDLE = 10.0
"""Seconds after which a thread without work ends."""
Work = Iterator[float]
"""Pieces of work; after each it yields the `time.monotonic()` before which the next one need not
begin. It must not raise."""


class Turns:
    """One thread that does a piece of work of each user in turn, only of the user's newest work."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._work: dict[Hashable, tuple[Work, float]] = {}
        """Each user's work and the time when it may go on, in the order of turns."""
        self._thread: threading.Thread | None = None
        self.is_working = False
        """Whether a piece of work is being done."""

    def put(self, user: Hashable, work: Work) -> None:
        """Begin a user's work, in place of any earlier work of this user."""
        with self._changed:
            self._work[user] = work, 0.0
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="explorer", daemon=True)
                self._thread.start()
            self._changed.notify()

    def drop(self, user: Hashable) -> None:
        """Do no further piece of a user's work."""
        with self._changed:
            self._work.pop(user, None)

    def _run(self) -> None:
        while found := self._next():
            user, work = found
            self.is_working = True
            when = next(work, None)
            self.is_working = False
            with self._changed:
                if self._work.get(user, (None,))[0] is work:  # else there is newer work
                    del self._work[user]
                    if when is not None:
                        self._work[user] = work, when  # behind all others

    def _next(self) -> tuple[Hashable, Work] | None:
        """Wait for work; return the next user with it, or None after `IDLE` seconds without any."""
        with self._changed:
            while True:
                now = time.monotonic()
                for user, (work, when) in self._work.items():
                    if when <= now:
                        return user, work
                soonest = min((when - now for _, when in self._work.values()), default=IDLE)
                if not self._changed.wait(soonest) and not self._work:
                    self._thread = None
                    return None
