#!/usr/bin/env python3
"""Reads the YAML files under .github and checks the structure of workflows and issue forms. actionlint checks more;
this covers machines where it cannot be installed. Needs PyYAML."""

import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent / ".github"
problems = []


def check_workflow(name, workflow):
    # YAML 1.1 reads the key `on` as true.
    for key in ("name", "permissions", "jobs"):
        if key not in workflow:
            problems.append(f"{name}: no {key}")
    if True not in workflow and "on" not in workflow:
        problems.append(f"{name}: no on")
    jobs = workflow.get("jobs") or {}
    for job_name, job in jobs.items():
        place = f"{name}: job {job_name}"
        for key in ("runs-on", "timeout-minutes", "steps"):
            if key not in job:
                problems.append(f"{place}: no {key}")
        needs = job.get("needs", [])
        for needed in [needs] if isinstance(needs, str) else needs:
            if needed not in jobs:
                problems.append(f"{place}: needs {needed}, which is no job")
        for number, step in enumerate(job.get("steps", []), 1):
            if ("uses" in step) == ("run" in step):
                problems.append(f"{place}, step {number}: expected either uses or run")
            if "uses" in step and "@" not in step["uses"]:
                problems.append(f"{place}, step {number}: {step['uses']} without a version")


def check_form(name, form):
    for key in ("name", "description", "body"):
        if key not in form:
            problems.append(f"{name}: no {key}")
    for number, item in enumerate(form.get("body", []), 1):
        if item.get("type") not in ("markdown", "input", "textarea", "dropdown", "checkboxes"):
            problems.append(f"{name}, item {number}: type {item.get('type')!r}")
        if item.get("type") == "markdown":
            continue
        if "id" not in item or "label" not in item.get("attributes", {}):
            problems.append(f"{name}, item {number}: expected an id and a label")


def main():
    workflows = sorted((ROOT / "workflows").glob("*.yml"))
    forms = sorted(path for path in (ROOT / "ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
    for paths, check in ((workflows, check_workflow), (forms, check_form)):
        if not paths:
            problems.append("no workflows or no forms under .github")
        for path in paths:
            try:
                check(path.name, yaml.safe_load(path.read_text(encoding="utf-8")))
            except yaml.YAMLError as error:
                problems.append(f"{path.name}: {error}")
    for line in problems:
        print(line)
    print(f"{len(workflows)} workflows, {len(forms)} forms, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
