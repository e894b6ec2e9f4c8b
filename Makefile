# The targets that CI calls, each usable alone inside an environment with '.[test]' installed.
.PHONY: test lint types imports docs client examples demo check

test:
	pytest

lint:
	ruff check .
	ruff format --check .

types:
	mypy

imports:
	lint-imports

docs:
	python tools/make_api.py --check

client:
	npm install --no-audit --no-fund --no-package-lock --silent
	npx --no-install tsc -p tsconfig.json

examples:
	set -e; for f in examples/[0-9]*.py; do echo "+ $$f"; python "$$f"; done

demo:
	mkdir -p out
	luxel demo --render out/demo.png --size 640x360

check: lint types imports docs client test examples demo
