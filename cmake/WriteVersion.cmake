# cmake -DSOURCE_DIR=... -DVERSION=... -DOUTPUT=... -P WriteVersion.cmake
# The commit comes from git or, in an archive that git made, from archived_commit.txt.

set(commit)
find_program(GIT git)
if(GIT AND EXISTS ${SOURCE_DIR}/.git)
  execute_process(COMMAND ${GIT} -C ${SOURCE_DIR} describe --always --dirty=+changes --exclude * --abbrev=9
    OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
else()
  file(STRINGS ${CMAKE_CURRENT_LIST_DIR}/archived_commit.txt commit LIMIT_COUNT 1)
  if(commit MATCHES "Format")
    set(commit)
  endif()
endif()

set(text "${VERSION}")
if(commit)
  set(text "${VERSION} (commit ${commit})")
endif()
set(source "#include \"core/version.h\"

const char* b3dgs::version() {
  return \"${text}\";
}
")
set(before)
if(EXISTS ${OUTPUT})
  file(READ ${OUTPUT} before)
endif()
if(NOT before STREQUAL source)
  file(WRITE ${OUTPUT} "${source}")
endif()
