"""Certificates as any tool makes them, self-signed, with their keys."""

import datetime
import ipaddress

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

CLIENT = x509.UniformResourceIdentifier("urn:test:client")
LOCAL = (x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1")))


def certificate(folder, name, days=(-1, 30), key=None, names=(CLIENT,)):
    """`name`.pem and `name`-key.pem in `folder`, valid for `days` from now, for the alternative `names`."""
    key = key or rsa.generate_private_key(65537, 2048)
    called = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    begin, end = (datetime.datetime.now(datetime.UTC) + datetime.timedelta(day) for day in days)
    made = x509.CertificateBuilder(called, called, key.public_key(), x509.random_serial_number(), begin, end)
    if names:
        made = made.add_extension(x509.SubjectAlternativeName(names), critical=False)
    private = folder / f"{name}-key.pem"
    private.touch(0o600)
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public = folder / f"{name}.pem"
    public.write_bytes(made.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM))
    return public, private
