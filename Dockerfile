# Image of all programs. Versions and hashes come from requirements.lock, development tools stay outside.
# tests/integration/test_image.py carries these steps out in a plain folder, without an engine and a package index.
FROM python:3.11.14-slim-bookworm AS build
WORKDIR /src
COPY pyproject.toml setup.py requirements.lock README.md LICENSE ./
COPY canlog canlog
COPY clutch_model clutch_model
COPY clutch_results clutch_results
COPY dbc dbc
COPY diag_service diag_service
COPY ecu_emulator ecu_emulator
COPY fleet fleet
COPY fleet_contract fleet_contract
COPY fleet_link fleet_link
COPY clutchdiag_io clutchdiag_io
COPY workshop workshop
# The lock's own uv installs the distributions: the lock then constrains, so only what the project needs comes in,
# and every file is held against the lock's hashes.
RUN awk '/^[^ #]/ { keep = /^uv==/ } keep' requirements.lock > /tmp/uv.lock \
 && python -m venv /opt/uv && /opt/uv/bin/pip install --no-cache-dir --require-hashes -r /tmp/uv.lock \
 && python -m venv --without-pip /opt/clutchdiag \
 && /opt/uv/bin/uv pip install --no-cache --python /opt/clutchdiag/bin/python \
      --constraints requirements.lock --build-constraints requirements.lock \
      "./canlog[mf4,parquet,zstd]" . "./workshop[diagnostics,odx,uds]" "./fleet[nats,page]"

FROM python:3.11.14-slim-bookworm
COPY --from=build /opt/clutchdiag /opt/clutchdiag
ENV PATH=/opt/clutchdiag/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/var/cache/clutchdiag \
    XDG_STATE_HOME=/var/lib
RUN useradd --system --no-create-home --user-group --uid 10001 clutchdiag \
 && install -d -o clutchdiag -g clutchdiag /var/cache/clutchdiag /var/lib/clutchdiag
# By number: who runs it with runAsNonRoot (Kubernetes) can tell that it is not root.
USER 10001:10001
# Compile the numerical kernels; a host with another processor compiles them again at its first start. A volume on the
# cache's folder begins with what is in the image, and keeps what such a host has compiled.
RUN ecu-emulator record /tmp/warm.log --scenario noise_only --cycles 1 \
 && diag-service analyze /tmp/warm.log --json > /dev/null \
 && python -c 'from clutchdiag_io.program import choose_kernel_cache as choose; choose(); \
      from diag_service.service.bus_run import warm_up; warm_up()' \
 && rm /tmp/warm*
CMD ["diag-service", "--help"]
