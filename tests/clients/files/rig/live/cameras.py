"""A camera that is no camera: an MJPEG stream on the loopback interface of boards that are rendered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

import cv2

from tests.clients.files.rig.see.boards import CHARUCO, small, taken

EVERY_S = 0.03


def picture(k: int, shift: float = 0.0) -> Any:
    """The board at pose k; ``shift`` mm away."""
    turns = [(12.0, -8.0, 4.0), (-15.0, 10.0, 30.0), (2.0, 22.0, -25.0), (20.0, 3.0, 80.0)]
    return taken(CHARUCO, small(rotation_deg=turns[k % 4], centre_mm=(shift, 0.0, 330.0 + 20.0 * (k // 4)), seed=k))


def jpeg(grey: Any) -> bytes:
    return bytes(cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])


@contextmanager
def mjpeg(
    frames: Callable[[], Iterator[bytes]], kind: str = "multipart/x-mixed-replace; boundary=frame"
) -> Iterator[str]:
    """Serve frames as a network camera does; its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.end_headers()
            try:
                for frame in frames():
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(frame)}\r\n\r\n"
                    self.wfile.write(head.encode() + frame + b"\r\n")
                    time.sleep(EVERY_S)
            except OSError:
                pass  # who watched has gone

        def log_message(self, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/stream"
    finally:
        server.shutdown()
        server.server_close()
