"""Why a router cannot be reached by TLS: Zenoh says the same as where nobody listens, so a handshake of our own tells.

Certificates are parameters of an endpoint, in Zenoh's words:
``tls/host:7447#root_ca_certificate_file=ca.pem;enable_mtls=true;connect_certificate_file=…;connect_private_key_file=…``.
"""

import re
import socket
import ssl
from contextlib import suppress
from pathlib import Path
from typing import Final

from fleet_bus.errors import SessionError

_PREFIX: Final = "tls/"
_ADDRESS: Final = re.compile(r"tls/(?:\[(?P<ip6>[^\]%]+)(?:%[^\]]*)?\]|(?P<host>[^:]+)):(?P<port>\d+)")
_CA: Final = "root_ca_certificate_file"
_CERTIFICATE: Final = "connect_certificate_file"
_KEY: Final = "connect_private_key_file"
#: Alerts of a router about the certificate of whoever connects, as OpenSSL names them, and what each means.
_ALERTS: Final = {
    "CERTIFICATE_REQUIRED": "it asks for a certificate, and none was shown",
    "UNKNOWN_CA": "it does not know the CA of the certificate that was shown",
    "CERTIFICATE_EXPIRED": "the certificate that was shown has expired",
    "CERTIFICATE_UNKNOWN": "it does not accept the certificate that was shown",
    "CERTIFICATE_REVOKED": "the certificate that was shown is revoked",
    "BAD_CERTIFICATE": "it does not accept the certificate that was shown",
    "HANDSHAKE_FAILURE": "it does not accept the certificate that was shown, or none was shown",
    "DECRYPT_ERROR": "the key does not belong to the certificate that was shown",
    "ACCESS_DENIED": "it does not admit the certificate that was shown",
}
#: OpenSSL's numbers of what is wrong with a certificate.
_EXPIRED, _NOT_YET = 10, 9
_UNTRUSTED: Final = (2, 18, 19, 20, 21)
_OTHER_NAME: Final = (62, 64)


def parameters(endpoint: str) -> dict[str, str]:
    """What stands behind ``#`` in an endpoint, by name."""
    pairs = (part.partition("=") for part in endpoint.partition("#")[2].split(";") if part)
    return {name: value for name, _, value in pairs}


def check_files(endpoint: str) -> None:
    """Raise ``SessionError`` if certificates that an endpoint names cannot be read, or do not fit their key."""
    if endpoint.startswith(_PREFIX):
        _context(endpoint)


def failure(endpoint: str, timeout: float = 2.0) -> str | None:
    """Why TLS with whoever listens at ``endpoint`` fails; None if it does not, nobody answers, or it is not ``tls/…``.

    Shakes hands as the endpoint says, with a router or anybody else, and takes ``timeout`` seconds at most for each of
    its steps. Raises ``SessionError`` as ``check_files``.
    """
    address = _ADDRESS.match(endpoint)
    if address is None:
        return None
    context, host = _context(endpoint), address["ip6"] or address["host"]
    try:
        connection = socket.create_connection((host, int(address["port"])), timeout)
    except OSError:
        return None
    at = f"{address[0]} answers, but TLS fails: "
    with connection:
        try:
            with context.wrap_socket(connection, server_hostname=host) as secured:
                # In TLS 1.3 what the router thinks of our certificate comes after the handshake, if at all.
                secured.settimeout(min(timeout, 0.5))
                with suppress(TimeoutError):
                    secured.recv(1)
        except ssl.SSLCertVerificationError as error:
            return at + _refused(error, host, endpoint)
        except ssl.SSLError as error:
            return at + _alert(error, endpoint)
        except OSError as error:
            return f"{at}no handshake ({error.strerror or error}); does a router listen for TLS there?"
    return None


def _context(endpoint: str) -> ssl.SSLContext:
    given = parameters(endpoint)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = given.get("verify_name_on_connect", "true") != "false"
    for name in (_CA, _CERTIFICATE, _KEY):
        if name in given and not _readable(Path(given[name])):
            raise SessionError(f"{name} {given[name]!r:.200} of {endpoint.partition('#')[0]} cannot be read")
    if _CA in given:
        try:
            context.load_verify_locations(given[_CA])
        except (ssl.SSLError, OSError):
            raise SessionError(f"{_CA} {given[_CA]!r:.200} holds no certificate in PEM") from None
    else:
        context.load_default_certs()
    if given.get("enable_mtls") == "true" and _CERTIFICATE in given and _KEY in given:
        try:
            context.load_cert_chain(given[_CERTIFICATE], given[_KEY], password="")
        except (ssl.SSLError, OSError):
            raise SessionError(
                f"{_CERTIFICATE} {given[_CERTIFICATE]!r:.200} and {_KEY} {given[_KEY]!r:.200} are no certificate in "
                "PEM with the key that belongs to it"
            ) from None
    return context


def _readable(path: Path) -> bool:
    try:
        with path.open("rb"):
            return True
    except OSError:
        return False


def _refused(error: ssl.SSLCertVerificationError, host: str, endpoint: str) -> str:
    code = error.verify_code
    if code == _EXPIRED:
        return "its certificate has expired: give the router a new one and restart it"
    if code == _NOT_YET:
        return "its certificate is not valid yet: is the clock of this machine right?"
    if code in _OTHER_NAME:
        return (
            f"its certificate is not for {host!r}: connect by a name that stands in it, issue one with this name, or "
            "add verify_name_on_connect=false to the endpoint"
        )
    if code in _UNTRUSTED:
        given = parameters(endpoint).get(_CA)
        if given is None:
            return f"its certificate is by an unknown CA: name the CA's file behind the endpoint, #{_CA}=…"
        return f"its certificate is not by the CA in {given}"
    return f"its certificate is refused ({error.verify_message})"


def _alert(error: ssl.SSLError, endpoint: str) -> str:
    reason = error.reason or str(error)
    given = parameters(endpoint)
    meaning = next((meaning for name, meaning in _ALERTS.items() if name in reason), None)
    if meaning is None:
        return f"{reason.lower().replace('_', ' ')}: does a router listen for TLS there?"
    if _CERTIFICATE not in given or _KEY not in given:
        return f"{meaning}: name it behind the endpoint, #enable_mtls=true;{_CERTIFICATE}=…;{_KEY}=…"
    if given.get("enable_mtls") != "true":
        return f"{meaning}: the one of the endpoint is used with enable_mtls=true only"
    return f"{meaning} ({given[_CERTIFICATE]})"
