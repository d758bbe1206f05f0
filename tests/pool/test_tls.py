"""A scheduler that takes only partners with a certificate."""

from __future__ import annotations

import shutil
import subprocess

import pytest

pytest.importorskip("distributed")

from ident.errors import IdentError
from ident.pool import Done, spread
from workers import cluster

CLIENT = "DASK_DISTRIBUTED__COMM__TLS__"


def square(common, task):
    return task**2


@pytest.fixture
def certificate(tmp_path):
    """A certificate that is its own authority, and its key."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
         "/CN=ident", "-keyout", key, "-out", cert],
        check=True, capture_output=True,
    )  # fmt: skip
    return str(cert), str(key)


def test_work_through_tls_and_nobody_without_a_certificate(tmp_path, certificate, monkeypatch):
    import dask

    cert, key = certificate
    names = {"ca-file": cert}
    for role in ("client", "scheduler", "worker"):
        names |= {f"{role}.cert": cert, f"{role}.key": key}
        for what, file in (("CERT", cert), ("KEY", key)):
            monkeypatch.setenv(f"{CLIENT}{role.upper()}__{what}", file)
    monkeypatch.setenv(f"{CLIENT}CA_FILE", cert)
    settings = {f"distributed.comm.tls.{name}": file for name, file in names.items()}
    with dask.config.set(settings), cluster(tmp_path, "--protocol", "tls") as found:
        assert found.address.startswith("tls://")
        found.start("one")
        found.wait_for(1)
        done = list(spread(square, range(3), scheduler=found.address))
        assert sorted(done, key=lambda each: each.index) == [Done(i, i**2) for i in range(3)]
        with (
            dask.config.set({f"distributed.comm.tls.{name}": None for name in names}),
            pytest.raises(IdentError, match=r"needs certificates; name them by DASK_.*CA_FILE"),
        ):
            list(spread(square, range(3), scheduler=found.address))
        with (
            dask.config.set({"distributed.comm.tls.ca-file": "/no/such/file"}),
            pytest.raises(IdentError, match=r"No such file.*name them by"),
        ):
            list(spread(square, range(3), scheduler=found.address))
