# One image for router, emulator, gateway and twin; docker-compose.yml says which command each runs.
FROM python:3.11-slim

WORKDIR /opt/board51
RUN python3 -m venv /opt/venv
ENV PATH=/opt/venv/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1

# The lock of what runs, without the tools of development, first: a change of code does not install the dependencies again.
COPY requirements-run.lock ./
RUN pip install --no-cache-dir --disable-pip-version-check --require-hashes -r requirements-run.lock
COPY pyproject.toml README.md LICENSE board51.py ./
COPY protocol ./protocol
COPY firmware ./firmware
COPY gateway ./gateway
COPY twin ./twin
# Editable: the kernels' compiled cache and the shipped files lie beside the code, where the user may write.
RUN pip install --no-cache-dir --disable-pip-version-check --no-deps --no-build-isolation -e . \
 && useradd --system --uid 5151 --create-home board51 \
 && mkdir -p /data/logs /data/hmi /var/cache/numba && chown -R board51 /data /var/cache/numba
ENV NUMBA_CACHE_DIR=/var/cache/numba MPLCONFIGDIR=/tmp/matplotlib
USER board51
# Compiles the kernels into the image (a twin that compiles while it runs misses its first samples) and shows that it works.
RUN board51 demo --out /tmp/demo && rm -rf /tmp/demo
VOLUME /data
ENTRYPOINT ["board51"]
CMD ["--help"]
