# Read by ctest. Every test has its subject's label and, but for those named here, the label `quick`: what tools/test.sh runs.
# A test is left out where it takes long and a quick one sees the same code, less thoroughly; the reason stands beside it.
set(long_tests
  # 26 runs; Watch.PhotographsBecomeAResultWhileTheyArrive and Pipeline.AddingNothingRedoesNothing compare an extended hull with a whole one, too
  Pipeline.AddedViewsGiveWhatAllAtOnceGive
  # Six runs; the floor by itself: Caps.AMoundOnTheFloorGoesAndFeetStay, Pipeline.AFloorThatTakesALegOffIsSaid
  Pipeline.TheTableIsFoundAndWhatLiesOnItGoes
  # Four solids at 256 voxels; Fair.IsNearerToTheObject and Fair.ThinPartsStay look at the same surface, less closely
  Fair.WhatIsRightAlreadyStays
  # Depth by itself: Stereo.*; in the whole job: manifest
  Pipeline.ConcavitiesAreCarvedByDepth
  Pipeline.CamerasOfStereoAreRefinedByTexture
  # Align.ABrokenMaskIsNamedAndDoesNoHarm; cli_align has cameras that are refused
  AlignPipeline.ABrokenMaskIsNotCarvedWith
  AlignPipeline.CamerasThatCannotBeTrustedEndTheRunUnlessAccepted
)
foreach(label align unit color stereo property options runner pipeline real gpu)
  foreach(test IN LISTS vdbcarve_${label}_tests_TESTS)
    list(FIND long_tests ${test} at)
    if(at EQUAL -1)
      set_tests_properties(${test} PROPERTIES LABELS "${label};quick")
    endif()
  endforeach()
endforeach()
