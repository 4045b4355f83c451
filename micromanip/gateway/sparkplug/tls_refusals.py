"""Why TLS with a broker came to nothing, in words: OpenSSL has names for that, which say little to who reads them.

In TLS 1.3 a broker judges our certificate after the handshake has ended for us: its alert comes with the first bytes
that are read, where paho sees an end of the connection and no reason. So the socket keeps it.
"""

from __future__ import annotations

import ssl
from typing import Any

_SAID = {
    "CERTIFICATE_REQUIRED": "it asks for a certificate of ours: give it tls.certificate and tls.key",
    "UNKNOWN_CA": "it does not know who has signed our certificate, tls.certificate",
    "CERTIFICATE_EXPIRED": "it says that our certificate, tls.certificate, has expired",
    "CERTIFICATE_REVOKED": "it says that our certificate, tls.certificate, is revoked",
    "CERTIFICATE_UNKNOWN": "it does not take our certificate, tls.certificate",
    "BAD_CERTIFICATE": "it does not take our certificate, tls.certificate",
    "HANDSHAKE_FAILURE": "it refuses the handshake of TLS: does it ask for a certificate of ours, tls.certificate?",
    "UNEXPECTED_EOF_WHILE_READING": "it ended the handshake of TLS: is it a port without TLS?",
    "WRONG_VERSION_NUMBER": "what it answers is not TLS: is it a port without TLS?",
}
"""By the ends of OpenSSL's names, which begin with a version of TLS."""


def told(problem: ssl.SSLError) -> str:
    """What went wrong."""
    if isinstance(problem, ssl.SSLCertVerificationError):
        return f"its certificate: {problem.verify_message}"
    reason = problem.reason or str(problem)
    return next((text for end, text in _SAID.items() if reason.endswith(end)), f"TLS fails: {reason}")


def keeping(found: list[str]) -> type[ssl.SSLSocket]:
    """A socket class that appends to `found` why TLS fails on it."""

    class Keeping(ssl.SSLSocket):
        """Paho leaves one whose handshake fails to the garbage collector: it closes itself."""

        def do_handshake(self, block: bool = False) -> None:
            try:
                super().do_handshake(block)
            except BaseException:
                self.close()
                raise

        def recv(self, *arguments: Any) -> bytes:
            try:
                return super().recv(*arguments)
            except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
                raise
            except ssl.SSLError as problem:
                found.append(told(problem))
                raise

    return Keeping
