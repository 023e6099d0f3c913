#!/bin/sh
# Sets up what the tests in tests/browser need: a Chromium, playwright to drive it, and axe-core.
# usage: set_up_browser.sh FOLDER PYTHON; fails with one line if something cannot be had here.
set -eu
folder=$1 python=$2
mkdir -p "$folder"

found() {
  command -v chromium || command -v chromium-browser || command -v google-chrome
}

if ! found >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  timeout 120 apt-get -qq update && timeout 300 apt-get -qq install --no-install-recommends chromium >/dev/null || true
fi
found >"$folder/chromium" || { echo "There is no Chromium: install the package chromium."; exit 1; }

"$python" -c "import playwright" 2>/dev/null \
  || "$python" -m pip install --quiet --disable-pip-version-check "playwright>=1.50" \
  || { echo "playwright cannot be installed from PyPI."; exit 1; }

[ -f "$folder/node_modules/axe-core/axe.min.js" ] \
  || timeout 180 npm install --silent --no-save --no-audit --no-fund --ignore-scripts --prefix "$folder" axe-core@4 \
  || { echo "axe-core cannot be installed: it takes npm, which comes with Node.js."; exit 1; }
