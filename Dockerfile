# The short suite on the real firmware, ready to fly:
#   docker build -t saranga-bench . && docker run --rm -v "$PWD/runs:/bench/runs" saranga-bench
# Its steps are the targets of the Makefile that the workflow runs too (tests/bench_ci holds them together).
FROM debian:12-slim

RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates g++ gcc git libc6-dev make python3 python3-dev python3-venv && rm -rf /var/lib/apt/lists/*

WORKDIR /bench
COPY . .

RUN make venv
RUN make sitl
RUN make kernels

CMD ["make", "flights"]
