"""Let this process reach workers by their address as a command with `--scheduler` does: with their key. Not a test."""

import dask


def admitted(client):
    """Return the setting by which Dask takes a client's key for every connection, as long as it holds."""
    key = client.security
    found = {"ca-file": key.tls_ca_file, "client.cert": key.tls_client_cert, "client.key": key.tls_client_key}
    return dask.config.set({f"distributed.comm.tls.{name}": value for name, value in found.items()})
