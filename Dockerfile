# The command alone: docker run --rm -p 127.0.0.1:7878:7878 IMAGE run --no-open --host 0.0.0.0
FROM rust:1-slim AS build
WORKDIR /dermis
COPY . .
RUN apt-get update && apt-get install -y --no-install-recommends build-essential \
    && cargo build --profile dist --locked -p dermis-cli

FROM debian:stable-slim
COPY --from=build /dermis/target/dist/dermis /usr/local/bin/dermis
COPY LICENSE-MIT LICENSE-APACHE /usr/share/doc/dermis/
RUN useradd --create-home dermis
USER dermis
WORKDIR /home/dermis
ENTRYPOINT ["dermis"]
