#!/usr/bin/env bash
# Renews the scripts of others that are committed: jsPsych for the pages, axe for their tests.
# Needs npm. jsPsych's packages hold no licence: its text, static/vendor/LICENSE, is that
# of its repository.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
pages=$PWD/static/vendor tests=$PWD/../tests/study/vendor
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# unpack PACKAGE: into $work/package
unpack() {
    rm -rf "$work/package"
    (cd "$work" && tar xzf "$(npm pack --silent "$1" 2>/dev/null)")
}

# keep FOLDER PACKAGE SOURCE NAME: without its source map, which would be fetched from elsewhere
keep() {
    sed '/^\/\/# sourceMappingURL/d' "$work/package/$3" >"$1/$4"
    echo "$(sha256sum <"$1/$4" | cut -d' ' -f1)  $4  $2" >>"$1/VERSIONS"
}

mkdir -p "$pages" "$tests"
: >"$pages/VERSIONS"
: >"$tests/VERSIONS"
unpack jspsych@8.3.0
keep "$pages" jspsych@8.3.0 dist/index.browser.min.js jspsych.js
unpack axe-core@4.14.1
keep "$tests" axe-core@4.14.1 axe.min.js axe.min.js
cp "$work/package/LICENSE" "$tests/LICENSE"
