# SPDX-License-Identifier: Apache-2.0
# Every third-party library, by its Debian 12 package (see ./dev).
find_package(Threads REQUIRED)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)    # libeigen3-dev
find_package(fmt REQUIRED)                     # libfmt-dev
find_package(tl-expected REQUIRED)             # libexpected-dev
find_package(PkgConfig REQUIRED)
find_path(ERFA_INCLUDE_DIR erfa.h REQUIRED)    # liberfa-dev
find_library(ERFA_LIBRARY erfa REQUIRED)
add_library(astronav_erfa INTERFACE)
target_include_directories(astronav_erfa SYSTEM INTERFACE ${ERFA_INCLUDE_DIR})
target_link_libraries(astronav_erfa INTERFACE ${ERFA_LIBRARY})
add_library(astronav::erfa ALIAS astronav_erfa)
