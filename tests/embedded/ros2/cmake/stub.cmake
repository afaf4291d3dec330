# The stand-ins as a CMake package of the name that find_package asks for.
get_filename_component(stubs "${CMAKE_CURRENT_LIST_DIR}/../include" ABSOLUTE)
set(name ${CMAKE_FIND_PACKAGE_NAME})
if(NOT TARGET ${name}::${name})
  add_library(${name}::${name} INTERFACE IMPORTED)
  set_target_properties(${name}::${name} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${stubs}")
endif()
set(${name}_TARGETS ${name}::${name})
