"""A connection to a cluster of dask.distributed, which is an extra and imported here alone."""

from __future__ import annotations

import contextlib
import json
import logging
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import ClusterError, UsageError
from accelcal_cli.core.names import printable

LOOK_S = 0.5
Said = Callable[[str], None]


@contextlib.contextmanager
def connected(told: str, said: Said) -> Iterator[Any]:
    """A client of the scheduler at an address, or of the one that wrote a scheduler file.

    It waits as long as distributed does (`distributed.comm.timeouts.connect`, 30 s unless configured). What
    distributed would print meanwhile is kept from the user, who is told in our words.

    Raises:
        UsageError: distributed is not installed.
        ClusterError: the scheduler cannot be reached.
    """
    library = _library()
    with _silence():
        client = _client(library, told, said)
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=5)


def _library() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise UsageError("--dask needs dask.distributed", hint="pip install 'accelcal[dask]'") from error
    return distributed


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _client(library: Any, told: str, said: Said) -> Any:
    import dask

    wait_s = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.connect"))
    address = _address(told, wait_s)
    _check(address)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            client = library.Client(address, timeout=wait_s, set_as_default=False, name="accelcal")
        except (OSError, ValueError, ImportError) as error:
            raise _unreachable(address, str(error), wait_s) from error
    if any(one.category.__name__ == "VersionMismatchWarning" for one in warned):
        said("Python or dask of the cluster are of other versions than here: that may fail")
    return client


def _check(address: str) -> None:
    from distributed.comm import parse_address
    from distributed.comm.registry import get_backend

    try:
        get_backend(parse_address(address)[0])
    except ValueError as error:
        raise UsageError(
            f"--dask {printable(address)} is no address", hint="use one such as tcp://host:8786"
        ) from error


def _unreachable(address: str, reason: str, wait_s: float) -> ClusterError:
    return ClusterError(
        f"no scheduler answers at {address} within {wait_s:g} s ({_short(reason)})",
        hint="start one with `dask scheduler`, and give its address or its --scheduler-file",
    )


def _short(reason: str) -> str:
    """The last of the causes that distributed strings together."""
    return " ".join(reason.split())[-120:].rpartition(": ")[2] or "no reason given"


def _address(told: str, wait_s: float) -> str:
    """The address itself; for a scheduler file what it holds, once it is there."""
    if not told.endswith(".json"):
        return told
    path, end = Path(told), time.monotonic() + wait_s
    while (address := _written(path)) is None and time.monotonic() < end:
        time.sleep(LOOK_S)
    if address is None:
        raise ClusterError(
            "no scheduler has written its address here", path=printable(path), hint="start `dask scheduler`"
        )
    return address


def _written(path: Path) -> str | None:
    try:
        found = json.loads(path.read_text("utf-8"))["address"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if isinstance(found, str) else None
