# SPDX-License-Identifier: Apache-2.0
# Writes the live view's page, with its style and script inside, as a C++ constant: cmake -DOUT=.. -DWEB=.. -P embed.cmake
file(READ "${WEB}/page.html" page)
file(READ "${WEB}/style.css" style)
file(READ "${WEB}/live.js" script)
string(REPLACE "/*STYLE*/" "${style}" page "${page}")
string(REPLACE "/*SCRIPT*/" "${script}" page "${page}")
file(WRITE "${OUT}.html" "${page}")
file(READ "${OUT}.html" content HEX)
string(LENGTH "${content}" digits)
math(EXPR bytes "${digits} / 2")
string(REGEX REPLACE "(................................................................)" "\\1\"\n\"" content "${content}")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "\\\\x\\1" content "${content}")
file(WRITE "${OUT}" "// Written by embed.cmake.\n#include \"simulator/server/assets.h\"\n\nnamespace astronav::server {\nconst std::string_view kLivePage(\n\"${content}\", ${bytes});\n}  // namespace astronav::server\n")
