"""Settings of one server, read from ``KILTER_*`` environment variables when they are asked for.

Which build of Kilter this is.
"""

from __future__ import annotations

import ipaddress
import json
import re
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def checked_topic(topic: str) -> str:
    """Return ``topic`` when it is a full name of ROS 2, else raise ValueError naming the rule."""
    if not _TOPIC.fullmatch(topic):
        raise ValueError(f"{topic!r} is not a full topic name: write it as /arm_controller/joint_trajectory.")
    return topic


Topic = Annotated[str, AfterValidator(checked_topic)]


class RobotTopics(BaseModel):
    """Topics of one robot, each a pair: where the wanted joints come from, where the corrected ones go."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    joint_state: tuple[Topic, Topic] | None = Field(default=None, description="sensor_msgs/JointState")
    joint_trajectory: tuple[Topic, Topic] | None = Field(default=None, description="trajectory_msgs/JointTrajectory")
    joints: tuple[str, ...] = Field(default=(), description="joints in ROS, base to tool; default: the robot's own")

    @model_validator(mode="after")
    def _from_one_topic_to_another(self) -> RobotTopics:
        pairs = [pair for pair in (self.joint_state, self.joint_trajectory) if pair]
        if not pairs:
            raise ValueError("give joint_state or joint_trajectory as a pair of topics")
        if any(wanted == corrected for wanted, corrected in pairs):
            raise ValueError("wanted and corrected joints need different topics, or they would be corrected forever")
        return self


Queue = Literal["short", "long"]
DATABASE_FILE = "kilter.sqlite"
JOBS_FILE = "jobs.sqlite"  # what older Kilters left: nobody reads it, and nobody else shall
LOCK_FILE = "serve.lock"
TOKEN_FILE = "token"  # noqa: S105 (the name of a file)
SERVER_FILE = "server.json"
CORRECTOR_FILE = "corrector.json"
STREAM_KEYS_FILE = "stream-keys.json"
LEAST_TOKEN, LEAST_DIFFERENT = 24, 8
WEAK_TOKEN = (
    f"the token is empty or can be guessed (it needs {LEAST_TOKEN} characters, {LEAST_DIFFERENT} different ones)"
)
GOOD_TOKEN = 'make a good one with `python3 -c "import secrets; print(secrets.token_urlsafe(32))"`'  # noqa: S105 (a sentence)


def default_data() -> Path:
    """Return the default data folder."""
    return Path.home() / ".kilter"


def parse_name_list(text: str) -> list[str]:
    """Return the names of a list with commas between them."""
    return [part.strip().lower() for part in text.split(",") if part.strip()]


def check_strong(token: str) -> None:
    """Refuse a token that can be guessed.

    Raises:
        ValueError: it is short, has few different characters, or characters that no header may hold.

    """
    if len(token) < LEAST_TOKEN or len(set(token)) < LEAST_DIFFERENT or not (token.isascii() and token.isprintable()):
        raise ValueError(f"{WEAK_TOKEN}: {GOOD_TOKEN}")
    if " " in token:
        raise ValueError(f"the token has a space: {GOOD_TOKEN}")


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
        default="tcp/127.0.0.1:7447", min_length=1, description="endpoint the corrector listens on; port 0: free"
    )
    stream_keys: Path | None = Field(default=None, description="file of the stream's master secret")
    seal_key: Path | None = Field(default=None, description="file of the key that rows are sealed with")
    stream_unsigned: bool = Field(default=True, description="take unsigned setpoints on loopback")
    site: str = Field(default="local", pattern=r"^[A-Za-z0-9_-]{1,64}$", description="site name in zenoh keys")
    temperature_c: float | None = Field(default=None, description="temperature of the arms, for thermal growth")
    ros2: dict[str, RobotTopics] = Field(default={}, description="topics of ROS 2 by robot, JSON; none: off")
    ros2_domain: Annotated[int, Field(ge=0, le=232, description="ROS_DOMAIN_ID")] = 0
    ros2_connect: str = Field(default="tcp/127.0.0.1:7447", description="zenoh router of ROS 2")
    ros2_zenoh_config: Path | None = Field(default=None, description="zenoh JSON5 configuration for the router of ROS")
    ros2_dialect: Literal["rmw_zenoh", "ros2dds"] = Field(default="rmw_zenoh", description="how ROS speaks zenoh")
    max_upload_mb: Annotated[int, Field(ge=1, description="largest file of observations or trajectory")] = 256
    max_document_mb: Annotated[int, Field(ge=1, le=64, description="largest robot, job or other JSON document")] = 4
    max_requests: Annotated[int, Field(ge=1, description="requests of a kind of work that are open at once")] = 64
    max_computing: Annotated[int, Field(ge=1, le=16, description="requests of a kind of work that compute at once")] = 2
    compute_limit_s: Annotated[float, Field(gt=0, description="seconds an answer that stores nothing may compute")] = (
        120.0
    )
    log_format: Literal["text", "json"] = Field(default="text", description="lines of the log")
    access_log: str | None = Field(default=None, description="file of the access log, - for the log itself")
    rate: Annotated[float, Field(gt=0, description="requests a second that compute, of one token or address")] = 100.0
    hosts: str = Field(default="", description="further names this server is reached by, with commas between them")
    proxy: str = Field(default="", description="addresses or networks of the proxy in front, with commas between them")
    tls_certificate: Path | None = Field(default=None, description="PEM file of the certificate: HTTPS")
    tls_key: Path | None = Field(default=None, description="PEM file of the certificate's private key")
    backups: Path | None = Field(default=None, description="folder of `kilterd backup`, whose age is watched")
    webhook_url: str | None = Field(default=None, description="address that verdicts of checks are posted to")
    webhook_secret: Path | None = Field(default=None, description="file of the secret that signs them")
    webhook_timeout_s: Annotated[float, Field(gt=0, le=60, description="seconds an attempt may wait for its peer")] = (
        5.0
    )
    keep_jobs_days: Annotated[int, Field(ge=0, description="days that ended jobs are kept; 0: for good")] = 0
    worker_name: str | None = Field(default=None, description="name of this worker; default is the host name")
    worker_processes: Annotated[
        int, Field(ge=1, le=256, description="processes for the folds and profiles of one job")
    ] = 1
    dask: Annotated[
        str | None,
        Field(pattern=r"^(tcp|tls)://[^/\s]+:[0-9]+$", description="Dask scheduler for the folds and profiles"),
    ] = None
    worker_queues: list[Queue] = Field(
        default=["short", "long"], min_length=1, description="queues this worker takes jobs from, JSON"
    )

    @field_validator("token")
    @classmethod
    def _strong(cls, token: SecretStr | None) -> SecretStr | None:
        if token is not None:
            check_strong(token.get_secret_value())
        return token

    @model_validator(mode="after")
    def _require_webhook_secret(self) -> Settings:
        if self.webhook_url is None:
            return self
        url = urlsplit(self.webhook_url)
        if url.scheme not in ("http", "https") or not url.hostname or url.username or url.password or url.fragment:
            raise ValueError(
                "KILTER_WEBHOOK_URL needs http:// or https:// with a host, and no name or password: "
                "https://alarms.example.org/kilter"
            )
        if self.webhook_secret is None:
            raise ValueError("KILTER_WEBHOOK_URL needs KILTER_WEBHOOK_SECRET: nothing is posted unsigned")
        return self

    @field_validator("proxy")
    @classmethod
    def _networks(cls, text: str) -> str:
        for part in parse_name_list(text):
            ipaddress.ip_network(part, strict=False)  # its own error says which part is not one
        return text

    def trusts(self, peer: str) -> bool:
        """Whether an address is that of the proxy in front of this server."""
        try:
            found = ipaddress.ip_address(peer)
        except ValueError:
            return False
        found = getattr(found, "ipv4_mapped", None) or found
        return any(found in ipaddress.ip_network(part, strict=False) for part in parse_name_list(self.proxy))

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
    def stream_keys_file(self) -> Path:
        """File of the master secret of the stream's sessions, readable by its owner only."""
        return self.stream_keys or self.data / STREAM_KEYS_FILE

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
            "STREAM_KEYS": str(self.stream_keys) if self.stream_keys else None,
            "SEAL_KEY": str(self.seal_key) if self.seal_key else None,
            "STREAM_UNSIGNED": str(self.stream_unsigned).lower(),
            "SITE": self.site,
            "TEMPERATURE_C": None if self.temperature_c is None else str(self.temperature_c),
            "ROS2": json.dumps({robot: topics.model_dump() for robot, topics in self.ros2.items()}),
            "ROS2_DOMAIN": str(self.ros2_domain),
            "ROS2_CONNECT": self.ros2_connect,
            "ROS2_ZENOH_CONFIG": str(self.ros2_zenoh_config) if self.ros2_zenoh_config else None,
            "ROS2_DIALECT": self.ros2_dialect,
            "MAX_UPLOAD_MB": str(self.max_upload_mb),
            "MAX_DOCUMENT_MB": str(self.max_document_mb),
            "MAX_REQUESTS": str(self.max_requests),
            "MAX_COMPUTING": str(self.max_computing),
            "COMPUTE_LIMIT_S": str(self.compute_limit_s),
            "LOG_FORMAT": self.log_format,
            "ACCESS_LOG": self.access_log,
            "RATE": str(self.rate),
            "HOSTS": self.hosts,
            "PROXY": self.proxy,
            "TLS_CERTIFICATE": str(self.tls_certificate) if self.tls_certificate else None,
            "TLS_KEY": str(self.tls_key) if self.tls_key else None,
            "BACKUPS": str(self.backups) if self.backups else None,
            "WEBHOOK_URL": self.webhook_url,
            "WEBHOOK_SECRET": str(self.webhook_secret) if self.webhook_secret else None,
            "WEBHOOK_TIMEOUT_S": str(self.webhook_timeout_s),
            "KEEP_JOBS_DAYS": str(self.keep_jobs_days),
            "WORKER_NAME": self.worker_name,
            "WORKER_PROCESSES": str(self.worker_processes),
            "DASK": self.dask,
            "WORKER_QUEUES": json.dumps(self.worker_queues),
        }
        return {f"KILTER_{name}": value for name, value in values.items() if value is not None}


SOURCE_TREE = "0.2.0+source"


@cache
def code_version() -> str:
    """Return the version of the installed distribution, or that of a source tree that is not installed."""
    try:
        return version("kilter")
    except PackageNotFoundError:
        return SOURCE_TREE
