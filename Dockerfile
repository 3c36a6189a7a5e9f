# docker build -t shearwarp .
# docker run --rm -p 8080:8080 -v /path/to/scans:/volumes:ro shearwarp --volumes /volumes

FROM rust:1.95-slim-trixie AS build
WORKDIR /build
# Dependencies change seldom: cargo's caches keep them from one build to the next.
COPY . .
RUN --mount=type=cache,target=/usr/local/cargo/registry --mount=type=cache,target=/build/target \
    cargo build --release --locked --bin shearwarp && cp target/release/shearwarp /shearwarp

FROM debian:trixie-slim
COPY --from=build /shearwarp /usr/local/bin/shearwarp
COPY config /etc/shearwarp
# A number, so that orchestrators can tell that it is not root.
USER 10001:10001
EXPOSE 8080
# Inside a container loopback is the container alone.
ENV SHEARWARP_LISTEN=0.0.0.0:8080
# By the shell's own sockets, so that the image needs no HTTP client. Assumes the port above.
HEALTHCHECK --interval=10s --timeout=3s --start-period=120s CMD ["bash", "-c", \
    "exec 3<>/dev/tcp/127.0.0.1/8080 && printf 'GET /readyz HTTP/1.0\\r\\n\\r\\n' >&3 && read -r -t 2 _ status _ <&3 && [ \"$status\" = 200 ]"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["shearwarp"]
