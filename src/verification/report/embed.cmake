# SPDX-License-Identifier: Apache-2.0
# Writes the files of the report page as C++ string constants: cmake -DOUT=.. -DWEB=.. -DUPLOT=.. -P embed.cmake
set(text "// Written by embed.cmake.\n#include \"verification/report/assets.h\"\n\nnamespace astronav::report::assets {\n")
foreach(pair "kPage|${WEB}/page.html" "kStyle|${WEB}/style.css" "kScript|${WEB}/report.js"
             "kUplotStyle|${UPLOT}/uPlot.min.css" "kUplotScript|${UPLOT}/uPlot.iife.min.js")
  string(REPLACE "|" ";" pair "${pair}")
  list(GET pair 0 name)
  list(GET pair 1 path)
  file(READ "${path}" content HEX)
  string(LENGTH "${content}" digits)
  math(EXPR bytes "${digits} / 2")
  string(REGEX REPLACE "(................................................................)" "\\1\"\n\"" content "${content}")
  string(REGEX REPLACE "([0-9a-f][0-9a-f])" "\\\\x\\1" content "${content}")
  string(APPEND text "const std::string_view ${name}(\n\"${content}\", ${bytes});\n")
endforeach()
string(APPEND text "}  // namespace astronav::report::assets\n")
file(WRITE "${OUT}" "${text}")
