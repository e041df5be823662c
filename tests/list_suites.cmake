# cmake -DPROGRAM=... -DOUTPUT=... -DFOLDER=... -DLABELS=... -P list_suites.cmake
# After a test program was linked: one test of ctest for each of its suites. LibTorch takes a third of a second to load,
# longer than most tests take, so a process runs a whole suite. Which of its tests failed is in the output.

execute_process(COMMAND ${PROGRAM} --gtest_list_tests OUTPUT_VARIABLE list COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "(^|\n)[A-Za-z0-9_/]+\\." suites "${list}")

# Skipped is a suite of which every test was, and none failed.
set(skipped "\\[  PASSED  \\] 0 tests\\.\n(\\[  SKIPPED \\][^\n]*\n)+$")
set(environment OMP_WAIT_POLICY=passive)
if(NOT LABELS MATCHES gpu)  # --device auto shall be the CPU
  list(APPEND environment CUDA_VISIBLE_DEVICES=)
endif()
set(text)
foreach(suite IN LISTS suites)
  string(REGEX REPLACE "[\n.]" "" suite "${suite}")
  set(alone OFF)
  if(suite MATCHES "RunsAlone$")  # it leaves nothing of a GPU's memory to others
    set(alone ON)
  endif()
  string(APPEND text "add_test([==[${suite}]==] [==[${PROGRAM}]==] [==[--gtest_filter=${suite}.*]==])\n"
    "set_tests_properties([==[${suite}]==] PROPERTIES WORKING_DIRECTORY [==[${FOLDER}]==] TIMEOUT 1800 RUN_SERIAL ${alone}\n"
    "  LABELS [==[${LABELS}]==] ENVIRONMENT [==[${environment}]==] SKIP_REGULAR_EXPRESSION [==[${skipped}]==])\n")
endforeach()
file(WRITE ${OUTPUT} "${text}")
