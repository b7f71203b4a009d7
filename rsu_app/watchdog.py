"""What the service manager is told: that the unit serves, that it stops, and again and again that it lives.

systemd names a socket in `NOTIFY_SOCKET`, and in `WATCHDOG_USEC` how long it bears silence before it starts the unit
anew. Started in any other way the unit tells nobody and needs nothing.

Alive is a unit whose event loop turns, or else nothing would be sent, and whose writer gets on with its writes. A full
disk is answered at once with an error, so it is no reason to start anew; a disk that does not answer at all is.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass

from rsu_app.ports import WriterPulse

STATUS_PERIOD_S = 10.0
"""How often the manager is told how the unit is where it does not ask for signs of life."""


@dataclass(frozen=True, slots=True)
class ServiceManager:
    """Who started the unit.

    Attributes:
        address: Its socket: a path, or `@` and a name without a file; empty where there is none.
        watchdog_s: The silence it bears; None if it does not watch.
    """

    address: str = ""
    watchdog_s: float | None = None

    @property
    def period_s(self) -> float:
        """How often it is told something: twice in the time of its patience."""
        return STATUS_PERIOD_S if self.watchdog_s is None else self.watchdog_s / 2


def manager_of(environment: Mapping[str, str], *, process_number: int) -> ServiceManager:
    """Return who started this process, as its environment tells.

    Args:
        environment: The variables of the process.
        process_number: Its own; a watchdog that waits for another process is none of this one's.
    """
    microseconds = environment.get("WATCHDOG_USEC", "")
    meant = environment.get("WATCHDOG_PID", str(process_number)) == str(process_number)
    watched = meant and microseconds.isascii() and microseconds.isdigit() and int(microseconds) > 0
    return ServiceManager(
        address=environment.get("NOTIFY_SOCKET", ""), watchdog_s=int(microseconds) / 1e6 if watched else None
    )


def tell(manager: ServiceManager, *words: str) -> bool:
    """Return whether the manager was told; never waits for it, and never fails.

    Args:
        manager: Who.
        words: Assignments such as "READY=1", one to a line.
    """
    if not manager.address:
        return False
    # An abstract name begins with a zero byte, which no environment can hold.
    name = "\0" + manager.address[1:] if manager.address.startswith("@") else manager.address
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as link:
        link.setblocking(False)  # noqa: FBT003 - the standard library's signature
        try:
            link.sendto("\n".join(words).encode(), name)
        except OSError:
            return False
    return True


def alive(pulse: WriterPulse, *, patience_s: float) -> bool:
    """Return whether the writer gets on: it waits for work, or began its present writes a short while ago.

    Args:
        pulse: What can be seen of the writer.
        patience_s: How long one group of writes may take; a worn flash card takes seconds now and then.
    """
    return pulse.busy_s < patience_s


def tell_how_it_is(manager: ServiceManager, pulse: WriterPulse, *, status: str) -> bool:
    """Return whether the unit is alive, after telling the manager so, or why not.

    Args:
        manager: Who waits for a sign of life.
        pulse: What can be seen of the writer.
        status: The unit in one line.
    """
    patience_s = manager.watchdog_s
    if patience_s is None or alive(pulse, patience_s=patience_s):
        tell(manager, *(() if patience_s is None else ("WATCHDOG=1",)), f"STATUS={status}")
        return True
    tell(manager, f"STATUS=the same write has been under way for {pulse.busy_s:.0f} s; waiting to be started anew")
    return False


def this_manager() -> ServiceManager:
    """Return who started this process."""
    return manager_of(os.environ, process_number=os.getpid())
