include("${CMAKE_CURRENT_LIST_DIR}/stub.cmake")
