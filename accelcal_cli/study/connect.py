"""A connection to a cluster of dask.distributed, which is an extra and imported here alone."""

from __future__ import annotations

import asyncio
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
        ClusterError: the scheduler cannot be reached, or is of another version.
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
    _check(library, address, wait_s)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            client = library.Client(address, timeout=wait_s, set_as_default=False, name="accelcal")
        except Exception as error:
            raise _unreachable(address, error) from error
    if any(one.category.__name__ == "VersionMismatchWarning" for one in warned):
        said("on the cluster some versions (Python, dask, numpy or others) are not those that are here")
    return client


def _check(library: Any, address: str, wait_s: float) -> None:
    """Ask for the version before a client is made: one of another version may fail, and then hangs."""
    from distributed.comm import parse_address
    from distributed.comm.registry import get_backend

    try:
        get_backend(parse_address(address)[0] if address else "")
    except ValueError as error:
        raise UsageError(
            f"--dask {printable(address)!r} is no address", hint="use one such as tcp://host:8786"
        ) from error
    try:
        there = asyncio.run(_version(library, address, wait_s))
    except Exception as error:
        raise _unreachable(address, error) from error
    if there != library.__version__:
        raise ClusterError(
            f"the scheduler at {address} has distributed {there}, here is {library.__version__}",
            hint="install the same version on every machine",
        )


async def _version(library: Any, address: str, wait_s: float) -> str:
    """Of the scheduler's distributed."""
    secured = library.Security().get_connection_args("client")
    async with asyncio.timeout(wait_s), library.rpc(address, connection_args=secured) as scheduler:
        return str((await scheduler.versions())["packages"]["distributed"])


def _unreachable(address: str, error: Exception) -> ClusterError:
    reason = " ".join(str(error).split()) or "no answer"
    return ClusterError(
        f"no scheduler answers at {address} ({reason})",
        hint="start one with `dask scheduler`, and give its address or its --scheduler-file",
    )


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
