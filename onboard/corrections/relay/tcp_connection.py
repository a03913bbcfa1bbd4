"""A TCP connection to a source of corrections. Opening has a time limit, and it is always
closed.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from onboard.config.endpoints import split_host_and_port
from onboard.corrections.relay.source_error import SourceError
from onboard.plain_text import plain_line

ANSWER_S = 10.0  # longest time to connect, and then to answer
SILENCE_S = 30.0  # time without a byte after which the connection is closed
READ_BYTES = 4096
_CLOSE_S = 1.0  # longest time to close a connection
_BUFFER_BYTES = 8192

Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@asynccontextmanager
async def connected(
    address: str, *, answer_s: float, context: ssl.SSLContext | None = None
) -> AsyncIterator[Connection]:
    """Connect, and close the connection at the end of the block.

    Args:
        address: HOST:PORT.
        answer_s: longest time to connect.
        context: settings of TLS; None for a connection without TLS.

    Raises:
        SourceError: the address cannot be reached.
    """
    host, port = split_host_and_port(address)
    try:
        async with asyncio.timeout(answer_s):
            reader, writer = await asyncio.open_connection(
                host, port, ssl=context, limit=_BUFFER_BYTES
            )
    except TimeoutError:
        raise SourceError(f"{address} does not answer within {answer_s:g} s.") from None
    except UnicodeError:
        raise SourceError(f"{address} cannot be reached: {host} is no name of a host.") from None
    except OSError as error:
        raise SourceError(f"{address} cannot be reached: {reason(error)}.") from None

    try:
        yield reader, writer
    finally:
        writer.close()
        with suppress(OSError, TimeoutError):
            async with asyncio.timeout(_CLOSE_S):
                await writer.wait_closed()


def reason(error: Exception) -> str:
    """Return why a connection failed, as plain text, since the other end may have written it."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return "its certificate is not valid for this address"
    if isinstance(error, OSError) and error.strerror:
        return plain_line(error.strerror.removesuffix("."))
    text = plain_line(str(error).removesuffix("."))
    if not text:
        return type(error).__name__
    return text
