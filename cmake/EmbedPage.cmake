# cmake -DFOLDER=... -DOUTPUT=... -P EmbedPage.cmake
# Makes one C++ string of FOLDER/page.html, with page.css in the place of @STYLE@ and the scripts in that of @SCRIPT@.

set(scripts)
foreach(name math camera charts path controls page)
  file(READ ${FOLDER}/${name}.js text)
  string(APPEND scripts "${text}")
endforeach()
file(READ ${FOLDER}/page.css style)
file(READ ${FOLDER}/page.html page)
string(REPLACE "@STYLE@" "${style}" page "${page}")
string(REPLACE "@SCRIPT@" "${scripts}" page "${page}")
file(WRITE ${OUTPUT} "namespace b3dgs {
extern const char* const kViewPage;
const char* const kViewPage = R\"b3dgs(${page})b3dgs\";
}  // namespace b3dgs
")
