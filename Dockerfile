# warp-partdr on the CPU. The command line, for files in the current folder:
#
#   docker build --tag partdr --build-arg PIP_EXTRA_INDEX_URL=INDEX .
#   docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD:/data" --volume partdr-cache:/cache partdr fit photo.jpg --out out
#
# INDEX is the address of PyTorch's own index of CPU builds, from its installation page; without it, pip takes the CUDA
# build, which is several gigabytes larger. The volume partdr-cache keeps compiled kernels from one run to the next.
FROM python:3.11-slim-bookworm AS build
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir --constraint constraints.txt setuptools \
    && pip wheel --no-deps --no-build-isolation --wheel-dir /wheels .

FROM python:3.11-slim-bookworm
ARG PIP_EXTRA_INDEX_URL
ARG EXTRAS=film,heic
WORKDIR /wheels
COPY constraints.txt .
COPY --from=build /wheels .
RUN pip install --no-cache-dir --constraint constraints.txt "$(ls ./*.whl)[$EXTRAS]"

# Any user may run it: what is written below a home goes to the cache.
RUN useradd partdr && mkdir --mode 1777 /cache
ENV USER=partdr HOME=/cache WARP_CACHE_PATH=/cache
USER partdr
WORKDIR /data
ENTRYPOINT ["partdr"]
CMD ["--help"]
