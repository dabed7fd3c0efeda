"""Who may do what over HTTP.

Reading is open to whoever reaches the port (loopback unless configured). Writing and moving need the token
in the Authorization header, never in a cookie, so another page's request cannot carry it. Requests that a
browser makes for another origin are refused all the same, and so are names that this machine does not
answer to: a foreign name that resolves to our address is how pages of others reach loopback ports.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Collection
from pathlib import Path
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mavcompass.errors import UsageError
from mavcompass.installation.private_files import write_private

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
MOST_BODY_BYTES = 65_536
_TOKEN_BYTES = 24

_PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self';"
    " manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors "
)
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
# In the name of an origin: whatever this computer was called by in the request, another port of it.
SAME_HOST = "{host}"


def page_policy(framed_by: Collection[str], host: str) -> str:
    """Say what the page may load, and which pages may show it in a frame of theirs.

    Args:
        host: of the request, checked already to be a name or an address of ours.
    """
    name = urlsplit(f"//{host}").hostname or ""
    name = f"[{name}]" if ":" in name else name
    return _PAGE_POLICY + (" ".join(origin.replace(SAME_HOST, name) for origin in framed_by) or "'none'")


def load_token(path: Path) -> str:
    """Read the secret, or make one that only this user can read. Raises UsageError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            write_private(path, secrets.token_urlsafe(_TOKEN_BYTES) + "\n")
        token = path.read_text().strip()
    except OSError as error:
        raise UsageError(
            f"The token file {path} cannot be used ({error.strerror}).",
            "Make its folder writable, or name another file as http.token_file.",
        ) from error
    if len(token) < 16:
        raise UsageError(
            f"The token in {path} is shorter than 16 letters.", "Remove the file; a new one is made."
        )
    return token


def own_names() -> frozenset[str]:
    """List the host names that this machine answers to."""
    name = socket.gethostname().lower()
    return frozenset({"localhost", name, f"{name}.local"})


class Guard:
    """Refuse what must not be done: wrong host 421, other origin 403, no token 401, too long 413."""

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        allowed_origins: Collection[str] = (),
        allowed_hosts: Collection[str] = (),
        framed_by: Collection[str] = (),
    ) -> None:
        self._app = app
        # An older word for frame-ancestors 'none', which knows no names.
        self._headers = _HEADERS if framed_by else (*_HEADERS, (b"x-frame-options", b"DENY"))
        self._token = token
        self._origins = frozenset(origin.lower() for origin in allowed_origins)
        self._hosts = own_names() | {host.lower() for host in allowed_hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass, or answer it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is None:
            await self._app(scope, receive, self._with_headers(send))
        elif scope["type"] == "websocket":
            await receive()  # the opening
            await send({"type": "websocket.close"})  # which a client that was not let in sees as 403
        else:
            await self._refuse(refusal, scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        host = headers.get("host", "")
        if not self._is_our_name(host):
            return 421, f"This service does not answer to the name {host!r}; see http.allowed_hosts."
        safe = scope["type"] == "http" and scope["method"] in SAFE_METHODS
        if not safe and not self._is_our_origin(headers, host):
            return 403, "Requests from other sites are refused; see http.allowed_origins."
        if safe or scope["type"] == "websocket":  # the stream only tells
            return None
        if not self._has_token(headers):
            return 401, "This needs the token, as Authorization: Bearer TOKEN; `mavcompass serve` shows it."
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST_BODY_BYTES:
            return 413, f"A request's body may have {MOST_BODY_BYTES} bytes."
        return None

    def _is_our_name(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
            if name in self._hosts:
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True  # an address, not a name: nobody can redirect it

    def _is_our_origin(self, headers: Headers, host: str) -> bool:
        if headers.get("sec-fetch-site") == "cross-site":
            return (headers.get("origin") or "").lower() in self._origins
        origin = headers.get("origin")
        if origin is None:
            return True  # no browser: the token decides
        try:
            return origin.lower() in self._origins or urlsplit(origin).netloc.lower() == host.lower()
        except ValueError:
            return False  # no address at all

    def _has_token(self, headers: Headers) -> bool:
        scheme, _, given = headers.get("authorization", "").partition(" ")
        return scheme.lower() == "bearer" and hmac.compare_digest(
            given.strip().encode("utf-8", "replace"), self._token.encode()
        )

    async def _refuse(self, refusal: tuple[int, str], scope: Scope, receive: Receive, send: Send) -> None:
        status, what = refusal
        extra = {"WWW-Authenticate": "Bearer"} if status == 401 else None
        await JSONResponse({"error": what}, status, extra)(scope, receive, self._with_headers(send))

    def _with_headers(self, send: Send) -> Send:
        """Add the headers that tell browsers to be careful."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self._headers]
            await send(message)

        return send_with_headers
