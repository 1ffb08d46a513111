#!/bin/sh
# Tests the live page in a real browser: against the demo, or with DERMIS_BIN=path/to/dermis against `dermis run`
# (DERMIS_ARGS adds arguments), or with BOOK=folder of the built book against the skin in its first page. Installs
# missing npm packages, and Chromium if apt is available.
set -eu
cd "$(dirname "$0")"

npm ci --no-audit --no-fund --loglevel=error

find_chromium() {
    for candidate in "${CHROMIUM:-}" chromium chromium-browser google-chrome; do
        [ -n "$candidate" ] && command -v "$candidate" && return 0
    done
    return 1
}
if ! CHROMIUM=$(find_chromium); then
    command -v apt-get >/dev/null || { echo "web/test.sh: no Chromium; install it or set CHROMIUM to its path" >&2; exit 1; }
    as_root=""
    [ "$(id -u)" -eq 0 ] || as_root="sudo"
    $as_root apt-get update -qq
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium
    CHROMIUM=$(find_chromium)
fi
export CHROMIUM

npm run --silent check
node build.mjs --check
[ -z "${BOOK:-}" ] || exec node --test --test-concurrency=1 tests/book.spec.mjs tests/instrument.spec.mjs
if [ -z "${DERMIS_BIN:-}${PAGE_DEMO_BIN:-}" ]; then
    cargo build --quiet --manifest-path ../Cargo.toml -p dermis-cli --example page_demo
fi
# Run one at a time: each has its own server and browser, and needs the machine's full speed.
exec node --test --test-concurrency=1 tests/page.spec.mjs tests/instrument.spec.mjs tests/layout.spec.mjs tests/damage.spec.mjs tests/body.spec.mjs
