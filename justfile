# Short names of what is done often; `just` lists them. Everything works without `just` as well.

_default:
    @just --list

# Every check and every test.
test:
    ./scripts/test

# The tests of one crate, e.g. `just crate dermis-tomo`.
crate name *arguments:
    cargo nextest run -p {{ name }} {{ arguments }}

# What a change needs before it is sent: format, lints, documentation.
check:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --locked -- -D warnings
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked

# The live page with the twin of a skin.
run skin="healing-square":
    cargo run --release -- run {{ skin }}

# The book, with a preview that follows changes.
book:
    mdbook serve docs

# Measured data of others that some tests compare with.
data:
    scripts/fetch-data
