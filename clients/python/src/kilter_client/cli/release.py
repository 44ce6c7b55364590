"""``kilter --version``: the release of this command, and of the server where one answers."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.errors import KilterError
from kilter_client.requests.connection import Connection, locate
from kilter_client.requests.steps import Document, Request, read

PATIENCE_S = 3.0
SOURCE_TREE = "0.2.0+source"


def show_releases(as_json: bool) -> None:
    """Print both releases; without a server the reason why it has none."""
    document: Document = {"kilter": own_release(), "server": None, "url": None}
    try:
        place = locate()
        document["url"] = place.url
        connection = Connection(place)
        found = connection.run(read(Request("GET", "/v1/health/live", timeout_s=PATIENCE_S)))
        document["server"] = found.get("version")
        connection.close()
    except KilterError as error:
        document["problem"] = error.detail
    emit(document, as_json, _show)


def own_release() -> str:
    """Return the release of the installed client, or that of a source tree that is not installed."""
    try:
        return version("kilter-client")
    except PackageNotFoundError:
        return SOURCE_TREE


def _show(document: Document) -> None:
    print_line(f"kilter {document['kilter']}")
    if document["server"]:
        print_line(f"server {document['server']} at {document['url']}")
    else:
        print_line(f"no server: {document['problem']}")
