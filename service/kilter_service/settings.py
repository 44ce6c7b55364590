"""Settings of one server, read from ``KILTER_*`` environment variables when they are asked for."""

from __future__ import annotations

import ipaddress
import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict

from kilter_service.ros2.topics import RobotTopics

Queue = Literal["short", "long"]
DATABASE_FILE = "kilter.sqlite"
TOKEN_FILE = "token"
SERVER_FILE = "server.json"
CORRECTOR_FILE = "corrector.json"


def default_data() -> Path:
    """Return the default data folder."""
    return Path.home() / ".kilter"


class Settings(BaseSettings):
    """Everything a process of Kilter needs to know; `kilterd serve` hands it to its children unchanged."""

    model_config = SettingsConfigDict(env_prefix="KILTER_", extra="ignore", frozen=True)

    data: Path = Field(default_factory=default_data, description="folder of database, token and server file")
    database_url: str | None = Field(default=None, description="SQLAlchemy URL; default is SQLite in the data folder")
    host: str = Field(default="127.0.0.1", description="address to listen on")
    port: Annotated[int, Field(ge=0, le=65535, description="port to listen on; 0 picks a free one")] = 8730
    token: SecretStr | None = Field(default=None, description="admin token; default is the data folder's token file")
    zenoh_config: Path | None = Field(default=None, description="zenoh JSON5 configuration of the corrector")
    zenoh_listen: str = Field(
        default="tcp/127.0.0.1:7447", description="endpoint the corrector listens on; port 0: free"
    )
    site: str = Field(default="local", pattern=r"^[A-Za-z0-9_-]{1,64}$", description="site name in zenoh keys")
    temperature_c: float | None = Field(default=None, description="temperature of the arms, for thermal growth")
    ros2: dict[str, RobotTopics] = Field(default={}, description="topics of ROS 2 by robot, JSON; none: off")
    ros2_domain: Annotated[int, Field(ge=0, le=232, description="ROS_DOMAIN_ID")] = 0
    ros2_connect: str = Field(default="tcp/127.0.0.1:7447", description="zenoh router of ROS 2")
    ros2_dialect: Literal["rmw_zenoh", "ros2dds"] = Field(default="rmw_zenoh", description="how ROS speaks zenoh")
    max_upload_mb: Annotated[int, Field(ge=1, description="largest file of observations or trajectory")] = 256
    max_document_mb: Annotated[int, Field(ge=1, le=64, description="largest robot, job or other JSON document")] = 4
    max_requests: Annotated[int, Field(ge=1, description="requests with a document that are inside at once")] = 32
    max_computing: Annotated[int, Field(ge=1, le=16, description="documents, and files, worked on at once")] = 2
    worker_name: str | None = Field(default=None, description="name of this worker; default is the host name")
    worker_processes: Annotated[int, Field(ge=1, le=256, description="processes for the folds of one job")] = 1
    worker_queues: list[Queue] = Field(
        default=["short", "long"], min_length=1, description="queues this worker takes jobs from, JSON"
    )

    @property
    def database(self) -> str:
        """SQLAlchemy URL of Kilter's own database."""
        return self.database_url or f"sqlite:///{self.data / DATABASE_FILE}"

    @property
    def sqlite_file(self) -> Path | None:
        """File of the database when it is SQLite, None when it is PostgreSQL."""
        if not self.database.startswith("sqlite"):
            return None
        return Path(self.database.partition("///")[2].partition("?")[0])

    @property
    def token_file(self) -> Path:
        """File that holds the admin token, readable by its owner only."""
        return self.data / TOKEN_FILE

    @property
    def server_file(self) -> Path:
        """File in which a running server writes its URL, process id and zenoh endpoint."""
        return self.data / SERVER_FILE

    @property
    def corrector_file(self) -> Path:
        """File in which a running corrector writes its process id and endpoints."""
        return self.data / CORRECTOR_FILE

    @property
    def is_loopback(self) -> bool:
        """Whether the server can be reached from this machine only."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    def environment(self) -> dict[str, str]:
        """Return these settings as environment variables for a child process."""
        values = {
            "DATA": str(self.data),
            "DATABASE_URL": self.database_url,
            "HOST": self.host,
            "PORT": str(self.port),
            "TOKEN": self.token.get_secret_value() if self.token else None,
            "ZENOH_CONFIG": str(self.zenoh_config) if self.zenoh_config else None,
            "ZENOH_LISTEN": self.zenoh_listen,
            "SITE": self.site,
            "TEMPERATURE_C": None if self.temperature_c is None else str(self.temperature_c),
            "ROS2": json.dumps({robot: topics.model_dump() for robot, topics in self.ros2.items()}),
            "ROS2_DOMAIN": str(self.ros2_domain),
            "ROS2_CONNECT": self.ros2_connect,
            "ROS2_DIALECT": self.ros2_dialect,
            "MAX_UPLOAD_MB": str(self.max_upload_mb),
            "MAX_DOCUMENT_MB": str(self.max_document_mb),
            "MAX_REQUESTS": str(self.max_requests),
            "MAX_COMPUTING": str(self.max_computing),
            "WORKER_NAME": self.worker_name,
            "WORKER_PROCESSES": str(self.worker_processes),
            "WORKER_QUEUES": json.dumps(self.worker_queues),
        }
        return {f"KILTER_{name}": value for name, value in values.items() if value is not None}
