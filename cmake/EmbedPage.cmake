# b3dgs_embed_page(SOURCE NAME PAGE FILES...) sets SOURCE to a generated C++ file that defines the string b3dgs::NAME.
# It is the HTML file PAGE, in which the style sheets among FILES replace @STYLE@, and the scripts replace @SCRIPT@. Both
# begin with uPlot, whose licence goes with it. Paths are relative to the folder of the caller.
function(b3dgs_embed_page source name page)
  set(output ${CMAKE_CURRENT_BINARY_DIR}/page.cpp)
  set(files ${page} ${ARGN})
  list(TRANSFORM files PREPEND ${CMAKE_CURRENT_SOURCE_DIR}/)
  set(uplot LICENSE uPlot.iife.min.js uPlot.min.css)
  list(TRANSFORM uplot PREPEND ${PROJECT_SOURCE_DIR}/third_party/uplot/)
  list(PREPEND files ${uplot})
  string(JOIN "|" joined ${files})
  add_custom_command(OUTPUT ${output}
    COMMAND ${CMAKE_COMMAND} -DOUTPUT=${output} -DNAME=${name} "-DFILES=${joined}"
      -P ${PROJECT_SOURCE_DIR}/cmake/EmbedPage.cmake
    DEPENDS ${files} ${PROJECT_SOURCE_DIR}/cmake/EmbedPage.cmake VERBATIM)
  set(${source} ${output} PARENT_SCOPE)
endfunction()

if(NOT CMAKE_SCRIPT_MODE_FILE)
  return()
endif()
string(REPLACE "|" ";" FILES "${FILES}")
set(scripts)
set(styles)
foreach(file ${FILES})
  file(READ ${file} text)
  if(file MATCHES "\\.js$")
    string(APPEND scripts "${text}")
  elseif(file MATCHES "\\.css$")
    string(APPEND styles "${text}")
  elseif(file MATCHES "/LICENSE$")
    string(APPEND scripts "/*\n${text}*/\n")
  else()
    set(page "${text}")
  endif()
endforeach()
string(REPLACE "@STYLE@" "${styles}" page "${page}")
string(REPLACE "@SCRIPT@" "${scripts}" page "${page}")
# Clang warns about strings of more than 64 KiB.
file(WRITE ${OUTPUT} "#pragma GCC diagnostic ignored \"-Woverlength-strings\"
namespace b3dgs {
extern const char* const ${NAME};
const char* const ${NAME} = R\"b3dgs(${page})b3dgs\";
}  // namespace b3dgs
")
