"""Who may enter a page that a command serves: a secret in its address, then a cookie; no other web page's requests.

Every user of a shared computer can connect to a port, also to one of 127.0.0.1. So the address that is printed holds a
secret, as a notebook server's does. A browser that opens it is given a cookie and sent
to the address without it, so that the secret stays out of the history and of screenshots; programs send it as the
header `X-Gs2ci-Secret`. Secrets are compared in a time that does not depend on where they differ.

Here: `Door`, and which port is listened on. Not here: what is served (`gs2ci.rig.live`, `gs2ci.evaluate.gate`).
"""

import hmac
import secrets
from collections.abc import Callable
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Final, TypeVar
from urllib.parse import parse_qs

from gs2ci.core.errors import InputError

LOCAL: Final = ("127.0.0.1", "localhost", "[::1]")
HEADER: Final = "X-Gs2ci-Secret"
PARAMETER: Final = "secret"
SECRET_BYTES: Final = 24
MOST_CONNECTIONS: Final = 256
_MOST_COOKIE_CHARACTERS: Final = 4096
# If a port is in use, often by an earlier page, this many of the following ones are tried.
PORTS_TRIED: Final = 20
_HIGHEST_PORT: Final = 65_535

_Listener = TypeVar("_Listener")

Header = Callable[[str], str]
"""Returns a header of a request by its name, "" if it has none."""


class Door:
    """The check of every request.

    Args:
        command: The command that serves, for the cookie and for messages.
        local: Whether only this machine is served, so that the request must name it.
    """

    def __init__(self, command: str, *, local: bool) -> None:
        self._command = command
        self.secret = secrets.token_urlsafe(SECRET_BYTES)
        self._local = local

    def refusal(self, port: int, header: Header, query: str) -> tuple[HTTPStatus, str] | None:
        """Return why a request is not answered, or None if it may be.

        Args:
            port: The port that is served: cookies are common to all ports of a host.
            header: The request's headers.
            query: The query string of its path.
        """
        host = header("Host")
        if self._local and host.rsplit(":", 1)[0] not in LOCAL:
            return HTTPStatus.MISDIRECTED_REQUEST, "the request was sent to another host name"
        origin = header("Origin")
        if origin and origin != f"http://{host}":
            return HTTPStatus.FORBIDDEN, "the request comes from another web page"
        if self.knows_by_query(query) or self._known(header(HEADER)) or self._known(self._cookie(port, header)):
            return None
        return HTTPStatus.FORBIDDEN, f"open the address that `{self._command}` has printed: it holds a secret"

    def knows_by_query(self, query: str) -> bool:
        """Return whether a query string holds the secret."""
        try:
            given = parse_qs(query, max_num_fields=16).get(PARAMETER, [""])
        except ValueError:  # more fields than any request of the page has
            return False
        return self._known(given[0])

    def cookie(self, port: int) -> str:
        """Return the header that gives a browser its cookie: for this page alone, and not for scripts."""
        return f"{self._name(port)}={self.secret}; Path=/; HttpOnly; SameSite=Strict"

    def _cookie(self, port: int, header: Header) -> str:
        cookies: SimpleCookie = SimpleCookie()
        try:
            cookies.load(header("Cookie")[:_MOST_COOKIE_CHARACTERS])
        except CookieError:
            return ""
        morsel = cookies.get(self._name(port))
        return "" if morsel is None else morsel.value

    def _known(self, given: str) -> bool:
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.secret.encode())

    def _name(self, port: int) -> str:
        return f"{self._command.replace(' ', '-')}-{port}"


def listening(host: str, port: int, listen: Callable[[tuple[str, int]], _Listener]) -> _Listener:
    """Listen on a port: this one or one of the next; any if it is 0.

    Args:
        host: The address to listen on.
        port: The first port to try.
        listen: Listens on an address and a port, or raises an OSError.

    Raises:
        InputError: There is none, or the host is no address of this machine.
    """
    if not 0 <= port <= _HIGHEST_PORT:
        raise InputError(f"port {port}", allowed=f"0 to {_HIGHEST_PORT}")
    tried = range(port, min(port + PORTS_TRIED, _HIGHEST_PORT + 1)) if port else range(1)
    for candidate in tried:
        try:
            return listen((host, candidate))
        except OSError as error:
            reason = error
    raise InputError(
        f"nothing can be served at {host}, port {tried[0]} to {tried[-1]}: {reason}",
        remedy="choose another --port, or a --host of this machine such as 127.0.0.1",
    )
