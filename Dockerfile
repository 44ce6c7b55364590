FROM python:3.11-slim AS build
WORKDIR /src
RUN python -m venv /opt/kilter
COPY constraints.txt ./
RUN /opt/kilter/bin/pip install --no-cache-dir --constraint constraints.txt hatchling editables
COPY pyproject.toml README.md LICENSE alembic.ini ./
COPY core core
COPY clients/files clients/files
COPY service service
COPY migrations migrations
RUN /opt/kilter/bin/pip install --no-cache-dir --no-build-isolation --constraint constraints.txt ./core './clients/files[formats]' '.[cluster,files,pdf,postgresql,tracing]'

FROM python:3.11-slim
LABEL org.opencontainers.image.title="Kilter" \
      org.opencontainers.image.version="0.2.0" \
      org.opencontainers.image.licenses="Apache-2.0"
# Reports as PDF are set by Pango; Debian keeps one version of it at a time, so none can be pinned.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0 fonts-dejavu-core \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --system --uid 10001 --create-home kilter \
    && install --directory --owner kilter --group kilter /data /keys
COPY --from=build /opt/kilter /opt/kilter
# A container is reached from outside it, so the server listens on every address and asks for KILTER_TOKEN. The corrector
# listens inside only: whoever reaches it can move the arm. docs/how-to/run-a-server.md says how to let controllers in.
# It speaks HTTP to the engine's network, through which a port that is published on the host's loopback address is reached;
# for other machines docs/how-to/run-a-server.md says how to give it a certificate.
# The compiled kernels are kept with the data: the program's own folder is not writable for the user that runs it.
ENV PATH=/opt/kilter/bin:$PATH \
    KILTER_DATA=/data \
    KILTER_HOST=0.0.0.0 \
    KILTER_PROXY=127.0.0.1,172.16.0.0/12 \
    NUMBA_CACHE_DIR=/data/kernels
USER 10001
VOLUME /data
EXPOSE 8730 7447
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s \
    CMD ["python", "-c", "import os, ssl, urllib.request as r; s = 's' if os.environ.get('KILTER_TLS_CERTIFICATE') else ''; r.urlopen(f'http{s}://127.0.0.1:{os.environ.get(\"KILTER_PORT\", 8730)}/v1/health/ready', context=ssl._create_unverified_context())"]
CMD ["kilterd", "serve"]
