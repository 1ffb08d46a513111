#!/usr/bin/env python3
"""Checks the requirements of crates.io and docs.rs for each published crate, and that no dependency needs a newer
compiler.

    scripts/check_packages.py               the checks; ends with the line `N crates, N problems`
    scripts/check_packages.py --features    lists what the stage `features` builds: crate, then a feature or nothing

Nothing is built and nothing is published.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# crates.io limits packages to 10 MiB, and keywords to five of at most 20 characters.
LARGEST_BYTES = 10 * 1024 * 1024
problems = []


def cargo(*arguments):
    command = ["cargo", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout


def metadata():
    return json.loads(cargo("metadata", "--locked", "--format-version", "1"))


def members(data):
    ours = set(data["workspace_members"])
    found = [package for package in data["packages"] if package["id"] in ours]
    return sorted(found, key=lambda package: package["name"])


def list_features(data):
    crates = members(data)
    for package in crates:
        features = sorted(set(package["features"]) - {"default"})
        # An optional dependency is a feature by itself only if no feature names it with `dep:`. Checking a crate that
        # passes each of its features on to another checks the other one as well.
        forwarded = {
            feature
            for other in crates
            for feature, means in other["features"].items()
            if f"{package['name']}/{feature}" in means
        }
        if forwarded.issuperset(features):
            continue
        print(package["name"])
        for feature in features:
            print(package["name"], feature)


def outside_files(folder):
    """Files that the sources embed from outside their crate, except those embedded only by documentation tests."""
    found = []
    for file in sorted((folder / "src").rglob("*.rs")):
        text = re.sub(r"#\[cfg\(doctest\)\]\n.*\n", "", file.read_text(encoding="utf-8"))
        for path in re.findall(r'include_(?:str|bytes)!\(\s*"([^"]+)"', text):
            target = Path(os.path.normpath(file.parent / path))
            if not target.is_relative_to(folder):
                found.append(str(target.relative_to(ROOT)))
    return found


def check_package(package, published):
    name, folder = package["name"], Path(package["manifest_path"]).parent

    def problem(what):
        problems.append(f"{name}: {what}")

    for key in ("description", "license", "repository", "rust_version", "readme"):
        if not package[key]:
            problem(f"no {key} in Cargo.toml")
    if package["readme"] and not (folder / package["readme"]).is_file():
        problem(f"readme = {package['readme']} is not there")
    keywords = package["keywords"]
    if not 1 <= len(keywords) <= 5 or any(len(word) > 20 for word in keywords):
        problem(f"keywords are {keywords}, expected 1 to 5 of at most 20 characters")
    if not 1 <= len(package["categories"]) <= 5:
        problem(f"categories are {package['categories']}, expected 1 to 5")
    for dependency in package["dependencies"]:
        if dependency["kind"] == "dev" and dependency["req"] == "*":
            continue  # Left out of the package, because tests are not run from there.
        if dependency.get("path") and dependency["name"] not in published:
            problem(f"depends on {dependency['name']}, which is not published")
        elif dependency["req"] == "*":
            problem(f"depends on {dependency['name']} without a version")
    if set(package["features"]) - {"default"} and not ((package["metadata"] or {}).get("docs") or {}).get("rs"):
        problem("has features but no [package.metadata.docs.rs] that says which are documented")
    files = cargo("package", "--list", "--allow-dirty", "--offline", "-p", name).split()
    size = sum((folder / file).stat().st_size for file in files if (folder / file).is_file())
    for wanted in ("Cargo.toml", "README.md"):
        if wanted not in files:
            problem(f"the package lacks {wanted}")
    if size > LARGEST_BYTES:
        problem(f"the package's files have {size} bytes, at most {LARGEST_BYTES}")
    outside = outside_files(folder)
    if outside:
        problem(f"embeds {outside[0]}, which its package does not hold")
    print(f"{name} {package['version']}: {len(files)} files, {size / 1024:.0f} KiB")


def check_compiler(data):
    """Checks that no dependency that is built for users states a newer compiler than the crates do."""
    packages = {package["id"]: package for package in data["packages"]}
    nodes = {node["id"]: node for node in data["resolve"]["nodes"]}
    ours = members(data)
    number = lambda version: tuple(int(part) for part in version.split(".")[:2])  # noqa: E731
    least = min(number(package["rust_version"]) for package in ours if package["rust_version"])
    seen, waiting = set(), [package["id"] for package in ours]
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        stated = packages[name]["rust_version"]
        if stated and number(stated) > least:
            label = f"{packages[name]['name']} {packages[name]['version']}"
            problems.append(f"{label}: needs Rust {stated}, newer than the stated {least[0]}.{least[1]}")
        for dependency in nodes[name]["deps"]:
            if any(kind["kind"] != "dev" for kind in dependency["dep_kinds"]):
                waiting.append(dependency["pkg"])
    print(f"{len(seen)} packages need Rust {least[0]}.{least[1]} or older, as far as they say")


def main(arguments):
    data = metadata()
    if arguments == ["--features"]:
        list_features(data)
        return 0
    ours = members(data)
    shipped = [package for package in ours if package["publish"] != []]
    published = {package["name"] for package in shipped}
    for package in shipped:
        check_package(package, published)
    check_compiler(data)
    for line in problems:
        print(f"problem: {line}")
    print(f"{len(shipped)} crates, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
