# Two ways to the same program. Both: not root, `signorini` as entry point, results in the mounted folder /work.
#
#   docker build -t signorini .                     Debian stable, the wheels with the versions pinned in pyproject.toml
#   docker build -t signorini --target debian .     Debian sid's own python3-dolfinx: Open MPI, PETSc with hypre
#   docker run --rm --user $(id -u):$(id -g) -v "$PWD":/work signorini solve example1 --plot
#   docker run --rm --entrypoint mpirun … signorini -n 2 signorini solve example2

# ---- Debian sid's stack; what Debian lacks comes from PyPI into a virtual environment that sees the system's packages
FROM debian:sid-slim AS debian
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates gcc g++ python3-dev python3-dolfinx python3-gmsh \
        python3-matplotlib python3-pydantic python3-pyvista python3-rich python3-typer python3-venv openmpi-bin \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY forms forms
COPY signorini_fenicsx signorini_fenicsx
COPY data data
RUN python3 -m venv --system-site-packages /opt/signorini \
    && /opt/signorini/bin/pip install --no-cache-dir '.[html,rigorous]' \
    && rm -rf build *.egg-info
COPY scripts /opt/signorini/scripts
ENV PATH=/opt/signorini/bin:$PATH OMP_NUM_THREADS=1 HOME=/tmp
WORKDIR /work
USER 1000:1000
ENTRYPOINT ["signorini"]

# ---- the environment of the wheels, with the system's Python
FROM debian:trixie-slim AS system
RUN apt-get update \
    && apt-get install -y --no-install-recommends gcc libc6-dev python3 python3-dev libgl1 libglu1-mesa libegl1 \
        libxrender1 libxcursor1 libxft2 libxinerama1 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
ENV PATH=/opt/signorini/bin:$PATH OMP_NUM_THREADS=1 HOME=/tmp

FROM system AS build
RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates python3-pip \
    && pip install --break-system-packages --no-cache-dir uv
ENV SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt UV_PYTHON=/usr/bin/python3 UV_PROJECT_ENVIRONMENT=/opt/signorini \
    UV_LINK_MODE=copy UV_NO_CACHE=1
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
RUN uv sync --no-dev --no-install-project --group dolfinx
COPY forms forms
COPY signorini_fenicsx signorini_fenicsx
COPY data data
RUN uv sync --no-dev --no-editable --group dolfinx
COPY scripts /opt/signorini/scripts

# ---- the tests, in the same environment and as the same user: docker build --target tests -t signorini-tests .
FROM build AS tests
RUN uv sync --no-editable
COPY scripts scripts
COPY tests tests
COPY docs docs
COPY CONTRIBUTING.md ./
RUN chown -R 1000:1000 /src
USER 1000:1000
ENTRYPOINT ["pytest"]

# ---- the default
FROM system
COPY --from=build /opt/signorini /opt/signorini
WORKDIR /work
USER 1000:1000
ENTRYPOINT ["signorini"]
