# Everything is made by `make`: first .venv from environment.lock, then the target. `make help` lists it.

PYTHON ?= python3
SERVE ?= 1
PORT ?= 8000
SCALE ?= tiny
JOBS ?= 2
FILMS ?= true
GRADES ?= runs/grades
LIMIT ?= 60

ifeq ($(OS),Windows_NT)
BIN := .venv/Scripts
else
BIN := .venv/bin
endif
PY := $(BIN)/python

CHAPTERS := $(wildcard book/chapters/*.md)
TOOLS := $(wildcard book/tools/*.py)
SCALES := $(patsubst data/config/%.yaml,%,$(wildcard data/config/*.yaml))
LIBRARY := $(wildcard detden_lite/*.py detden_lite/*/*.py)
DATA := $(wildcard data/* data/*/*)
BOOK := $(CHAPTERS) $(TOOLS) $(wildcard book/*.* book/api/* book/_static/* book/images/* book/viewer/*/* book/playground/page/*)
PLAYGROUND := $(wildcard book/playground/*.json book/playground/src/*.js)
FAST := core victims simulation defense attacks training store theory results checks test_rooms.py test_bad_inputs.py

.DEFAULT_GOAL := help
.PHONY: help book pdf test test-fast notebooks grade lab data durations bench lint lock clean

# Here, and not in the recipe of data: what cannot be made is refused before the environment is made for it.
ifneq ($(filter data,$(MAKECMDGOALS)),)
ifneq ($(words $(SCALE))$(filter-out $(SCALES),$(SCALE)),1)
$(error SCALE=$(SCALE) is unknown; choose one of: $(SCALES))
endif
endif

help: ## List the targets
	@$(PYTHON) -c "import re; [print(f'make {t:<10} {d}') for t, d in re.findall(r'^([\w-]+):.*?## (.+)$$', open('Makefile', encoding='utf-8').read(), re.M)]"

book: _build/html.stamp ## Build the book and serve it at localhost (SERVE=0: only build; PORT=8000)
ifneq ($(SERVE),0)
	$(PY) book/tools/serve.py _build/html $(PORT)
endif

pdf: _build/book.pdf ## Print the whole book to _build/book.pdf, through a headless Chromium

_build/book.pdf: _build/html.stamp book/tools/pdf.py
	$(PY) book/tools/pdf.py _build/html $@

test test-fast: export OMP_NUM_THREADS := 1
test: _build/html.stamp _build/axe/axe.min.js ## Run the tests: the library, the notebooks, the built book in a browser
	$(PY) book/tools/student.py --solved runs/solved
	$(PY) -m pytest tests runs/solved --nbmake --nbmake-timeout=300 -n $(JOBS)

test-fast: .venv/stamp ## Run the quick tests of the library: no book, no browser, no recipe
	$(PY) -m pytest $(addprefix tests/,$(FAST)) -m "not slow"

notebooks: .venv/stamp ## Write notebooks/ from book/chapters/
	$(PY) book/tools/student.py notebooks

grade: .venv/stamp ## Check what students handed in (SUBMISSIONS=FOLDER with a folder of notebooks for each; GRADES=runs/grades; LIMIT=60 seconds)
	$(PY) book/tools/grade.py "$(SUBMISSIONS)" "$(GRADES)" --limit $(LIMIT)

# It serves the whole repository: notebooks link to films and pages beside them. LAB takes more options of JupyterLab.
lab: .venv/stamp ## Open the notebooks in JupyterLab
	$(PY) -m jupyter lab --ServerApp.root_dir=. --LabApp.default_url=/lab/tree/notebooks $(LAB)

# GOALS takes whatever else Snakemake knows: -n, --unlock, publish.
data: .venv/stamp ## Make everything in data/ again, in runs/SCALE (SCALE=tiny, lite, paper; ROWS="hopper-td3 ant-ppo"; JOBS=2; FILMS=false)
	$(PY) -m snakemake $(GOALS) --snakefile data/Snakefile --configfile data/config/$(SCALE).yaml --directory runs/$(SCALE) --jobs $(JOBS) --config only="$(ROWS)" films=$(FILMS)

durations: .venv/stamp ## Print how long each stage of make data SCALE=lite takes, and how fast victims train
	$(PY) book/tools/durations.py

bench: .venv/stamp ## Print the benchmarks
	$(PY) -c "import pathlib, subprocess, sys; [subprocess.run([sys.executable, str(p)], check=True) for p in sorted(pathlib.Path('tests/benchmarks').glob('*.py'))]"

lint: .venv/stamp ## Check the style, which room imports from which, and the types
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(BIN)/lint-imports
	$(PY) -m mypy

lock: .venv/stamp ## Resolve environment.lock again from pyproject.toml
	$(BIN)/uv pip compile -q pyproject.toml --extra all --universal --python-version 3.11 --generate-hashes --no-emit-index-url --custom-compile-command "make lock" --upgrade -o environment.lock

clean: ## Remove everything that was made, .venv included
	$(PYTHON) -c "import shutil; [shutil.rmtree(d, ignore_errors=True) for d in ('_build', '.venv')]"

# uv itself is in the lock: pip installs it by its hashes, and it installs the rest. The build constraints pin, with
# hashes, what builds the one package that comes as source. This package is built by the hatchling of the lock.
.venv/stamp: environment.lock pyproject.toml
	@$(PYTHON) -c "import sys; (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.exit('Python 3.11, 3.12 or 3.13 is needed, and $(PYTHON) is ' + sys.version.split()[0] + ': name another one, as in: make PYTHON=python3.12 ...')"
	$(PYTHON) -m venv .venv
	sed -n '/^uv==/,/[^\\]$$/p' environment.lock > .venv/uv.txt
	$(PY) -m pip install -q --disable-pip-version-check --require-hashes -r .venv/uv.txt
	$(BIN)/uv pip sync -q --python $(PY) --require-hashes --build-constraints environment.lock environment.lock
	$(BIN)/uv pip install -q --python $(PY) --no-deps --no-build-isolation --editable .
	@$(PY) -c "open('.venv/stamp', 'w')"

# The cache of executed chapters knows their code, but neither the library nor the data: when those change, it goes.
_build/cache.stamp: .venv/stamp $(LIBRARY) $(DATA)
	$(PY) -c "import pathlib, shutil; shutil.rmtree('_build/new/_build/.jupyter_cache', ignore_errors=True); pathlib.Path('_build').mkdir(exist_ok=True); open('$@', 'w')"

_build/vendor/widgets/embed.js _build/axe/axe.min.js: .venv/stamp book/tools/widget_player.py
	$(PY) book/tools/widget_player.py $@

_build/vendor/playground/playground.js: .venv/stamp book/tools/build_playground.py $(PLAYGROUND) $(DATA)
	$(PY) book/tools/build_playground.py _build/playground _build/vendor/playground

# The book is built aside and takes its place when it is whole: a build that fails or is interrupted leaves the old one.
_build/html.stamp: _build/cache.stamp _build/vendor/widgets/embed.js _build/vendor/playground/playground.js $(BOOK)
	$(PY) -c "import shutil; shutil.rmtree('_build/new/_build/html', ignore_errors=True)"
	$(BIN)/jupyter-book build book --path-output _build/new --all --warningiserror --keep-going
	@$(PY) -c "import os, shutil; shutil.rmtree('_build/old', ignore_errors=True); os.path.exists('_build/html') and os.rename('_build/html', '_build/old'); os.rename('_build/new/_build/html', '_build/html'); shutil.rmtree('_build/old', ignore_errors=True)"
	@$(PY) -c "open('$@', 'w')"
